# SPDX-License-Identifier: Apache-2.0
"""Settings of a training run: one dataclass per concern, one flat namespace.

Their names are also those of the ROS parameters, and the keys of presets and of a run's
`config.yaml`.
"""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
from dataclasses import fields
from dataclasses import replace
from typing import Any

from ppo_agent_node.config.curriculum_config import CurriculumConfig
from ppo_agent_node.config.imitation_config import UNSET
from ppo_agent_node.config.imitation_config import CloneConfig
from ppo_agent_node.config.imitation_config import DemonstrationConfig
from rocket_sim_node import settings as settings_module
from rocket_sim_node.settings import SettingInfo
from rocket_sim_node.settings import setting
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.rocket import conditions
from rocket_sim_node.worlds.rocket.spawn import SPAWN_SETTINGS

DEVICES = ('auto', 'cpu', 'cuda')
"""names of the devices on which tensors are computed"""

_STARTS_OF_LEVELS = tuple(f'demonstration_{name}' for name in SPAWN_SETTINGS)
"""Settings without effect in worlds without levels."""


@dataclass(frozen=True)
class NetworkConfig:
    """Architecture and initialisation of actor and critic."""

    hidden_sizes: tuple[int, ...] = setting(
        (256, 256), '', 'units of the hidden layers of actor and critic', 1, 16_384)
    activation: str = setting(
        'tanh', '', 'activation function after each hidden layer', choices=('tanh', 'relu'))
    fine_observations: str = setting(
        'pad_y', '', 'names of observations that are compressed by asinh, separated by spaces or '
        'commas; names that the world lacks are ignored')
    fine_width: float = setting(
        0.02, '', 'width around zero within which that compression is linear', 1e-9, 1e9)
    hidden_observations: str = setting(
        '', '', 'names of observations that the critic sees and the policy does not, separated '
        'by spaces or commas; none that features use; names that the world lacks are ignored')
    features: str = setting(
        'none', '', 'additional inputs of actor and critic; descent: required deceleration, time '
        'to go, flare rate and guidance terms; guidance: also the predicted miss distance without '
        'control and the lean at which turning can be stopped; rocket worlds only',
        choices=('none', 'descent', 'guidance'))
    symmetry: str = setting(
        'none', '', 'symmetries of actor and critic: a mirrored observation gives the mirrored '
        "action and the same value; mirrors: across x and z, a lander's across x; turns: also "
        'quarter turns about the vertical. Layers need multiples of 4 (mirrors), 2 (landers) or '
        '8 (turns) units', choices=('none', 'mirrors', 'turns'))
    exploration: str = setting(
        'independent', '', 'noise of continuous actions in roll-outs; independent: drawn anew for '
        'each step; state_dependent: the same function of the state throughout an episode '
        '(start_copies) or roll-out, so that each rocket flies a slightly different policy',
        choices=('independent', 'state_dependent'))
    log_std_init: float = setting(
        -2.8, '', 'initial log standard deviation of the actions', -10.0, 2.0)
    log_std_final: float = setting(
        -3.7, '', 'upper bound of the log standard deviation at the last iteration; the bound '
        'falls linearly from log_std_init; log_std_init or more: no bound', -10.0, 20.0)
    log_std_floor: float = setting(
        -4.5, '', 'lower bound of the log standard deviation', -10.0, 2.0)


@dataclass(frozen=True)
class PPOConfig:
    """Settings of proximal policy optimisation."""

    iterations: int = setting(70, '', 'number of iterations, each a roll-out followed by an '
        'update', 0, 1_000_000)
    n_steps: int = setting(256, 'steps', 'steps per rocket in a roll-out', 1, 1_000_000)
    num_groups: int = setting(
        1, '', "number of groups in a roll-out, each of a simulator's num_envs rockets. A free "
        'simulator flies the next group, so use at least as many groups as simulators', 1, 4096)
    start_copies: int = setting(
        1, '', 'number of rockets that fly each start, in roll-outs of one whole episode per '
        'rocket. The advantage is the return of an episode relative to those of its copies. '
        'If it does not divide num_envs, the largest smaller number that does is used. 1: '
        'roll-outs of n_steps with a critic', 1, 4096)
    normalise_starts: bool = setting(
        True, '', "whether the advantages of a start's copies (start_copies) are divided by the "
        'standard deviation of their returns, so that all starts count alike')
    scatter_steps: int = setting(
        512, 'steps', "steps flown after a change of level, about an episode, so that the "
        "rockets' episodes are out of phase; 0: none", 0, 1_000_000)
    n_epochs: int = setting(2, '', 'number of passes over a roll-out', 1, 1000)
    batch_size: int = setting(4096, '', 'samples in a minibatch', 1, 10_000_000)
    trained_layers: int = setting(
        0, '', "number of the policy's layers, counted from its output, that PPO trains; the "
        'others stay as they are; 0, or more than it has: all', 0, 1000)
    clip_range: float = setting(
        0.1, '', 'clip range of the probability ratio, epsilon', 1e-6, 10.0)
    value_clip_range: float = setting(
        0.0, '', "clip range of the critic's change, in units of its value; 0: not "
        'clipped', 0.0, 1e9)
    gamma: float = setting(0.9999, '', 'discount factor per step', 0.0, 1.0)
    gamma_first: float = setting(
        -1.0, '', 'discount factor of the first iteration; 1 - gamma changes geometrically from '
        'there to the last iteration; -1: gamma throughout', -1.0, 1.0)
    gae_lambda: float = setting(
        0.99, '', 'lambda of generalised advantage estimation (GAE)', 0.0, 1.0)
    entropy_coefficient: float = setting(0.0, '', 'weight of the entropy bonus', 0.0, 100.0)
    entropy_coefficient_final: float = setting(
        -1.0, '', 'final weight of the entropy bonus: approached linearly, it would be reached '
        'one iteration after the last; -1: constant', -1.0, 100.0)
    max_grad_norm: float = setting(
        0.5, '', "maximum norm of each network's gradient", 1e-9, 1e9)
    actor_learning_rate: float = setting(
        3e-5, '', 'learning rate of Adam at the first iteration', 0.0, 1.0)
    critic_learning_rate: float = setting(
        1e-3, '', 'learning rate of Adam at the first iteration', 0.0, 1.0)
    log_std_learning_rate: float = setting(
        1e-3, '', 'learning rate of Adam for the log standard deviation at the first '
        'iteration', 0.0, 1.0)
    learning_rate_decay: bool = setting(True, '', 'whether all learning rates fall linearly to 0')
    desired_kl: float = setting(
        0.0, 'nats', "desired KL divergence of an update: above twice this value the actor's "
        'learning rate is divided by 1.5, below half of it multiplied by 1.5; 0: not adapted',
        0.0, 1e3)
    target_kl: float = setting(
        0.03, 'nats', 'KL divergence beyond which an update ends early; 0: never', 0.0, 1e3)
    reward_scale: float = setting(
        0.01, '', 'factor by which rewards are multiplied for learning', 1e-9, 1e9)
    normalise_advantages: bool = setting(
        True, '', 'whether the advantages of a minibatch are normalised to mean 0 and standard '
        'deviation 1')
    critic_warmup_iterations: int = setting(
        12, '', 'number of first iterations that train the critic only; fewer than iterations; '
        'none with start_copies above 1, where there is no critic to train', 0, 1_000_000)

    @property
    def whole_episodes(self) -> bool:
        """Whether a roll-out consists of whole episodes from new starts."""
        return self.start_copies > 1


@dataclass(frozen=True)
class RunConfig:
    """Settings of a run that do not concern learning."""

    seed: int = setting(1, '', 'seed of all random numbers of the run', 0, 2**31 - 1)
    threads: int = setting(2, '', "number of PyTorch's threads", 1, 1024)
    device: str = setting(
        'auto', '', 'device on which updates are computed; auto: the GPU if there is one. The '
        'same seed gives different weights on different devices, also in a resumed run',
        choices=DEVICES)
    checkpoint_interval: int = setting(
        5, 'iterations', 'interval between checkpoints; a stop also writes one', 1, 1_000_000)
    selection_interval: int = setting(
        5, 'iterations', 'interval between flights without noise, which select the best policy',
        1, 1_000_000)
    selection_from_landing_rate: float = setting(
        0.0, '', 'minimum landing rate of the last curriculum_window episodes of roll-outs for a '
        'selection to take place, unless the level or the reach has just risen; in a reverse '
        'curriculum, only the highest starts count',
        0.0, 1.0)
    selection_episodes: int = setting(
        512, '', 'number of episodes of a selection, at least one per rocket', 1, 1_000_000)
    training_episodes: int = setting(
        0, 'episodes', 'number of episodes after which fine-tuning ends with its iteration; 0: it '
        'ends after its iterations', 0, 1_000_000_000)
    target_return: float = setting(
        1e9, '', 'mean return of a selection at which fine-tuning ends; the default cannot be '
        'reached', -1e9, 1e9)
    episode_lines: bool = setting(
        False, '', 'print the score of each episode of fine-tuning and the average of the last '
        '50, keep the scores in train.jsonl and plot them')
    evaluation_episodes: int = setting(
        2000, '', 'number of episodes of the final evaluation', 1, 10_000_000)
    evaluation_seed: int = setting(
        20_000_000, '', 'seed of the final evaluation; training never uses it', 0, 2**31 - 1)
    plots: bool = setting(
        True, '', 'after the final evaluation, draw plots and write a report, which takes seconds')


@dataclass(frozen=True)
class Config:
    """All settings of a run, by concern."""

    demonstration: DemonstrationConfig = field(default_factory=DemonstrationConfig)
    clone: CloneConfig = field(default_factory=CloneConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    ppo: PPOConfig = field(default_factory=PPOConfig)
    curriculum: CurriculumConfig = field(default_factory=CurriculumConfig)
    run: RunConfig = field(default_factory=RunConfig)

    def flat(self) -> dict[str, Any]:
        """Return all settings by name."""
        return {
            name: value
            for concern in fields(self)
            for name, value in settings_module.as_dict(getattr(self, concern.name)).items()
        }


_CONCERNS: dict[str, type] = {
    'demonstration': DemonstrationConfig, 'clone': CloneConfig, 'network': NetworkConfig,
    'ppo': PPOConfig, 'curriculum': CurriculumConfig, 'run': RunConfig,
}


def describe() -> tuple[SettingInfo, ...]:
    """Return the settings of a run, in order of concern; names are unique."""
    return tuple(
        info for concern in _CONCERNS.values() for info in settings_module.describe(concern))


def make_config(values: Mapping[str, object]) -> Config:
    """Create a run's settings from values by name; the rest have their defaults.

    :raises ValueError: for an unknown name, a value out of range, or a contradiction.
    :raises TypeError: for a value of the wrong type.
    """
    known = {info.name for info in describe()}
    unknown = sorted(set(values) - known)
    if unknown:
        raise ValueError(
            f'unknown setting {", ".join(map(repr, unknown))}, '
            f'expected {", ".join(sorted(known))}')
    config = Config(**{
        concern: settings_module.build(cls, {
            info.name: values[info.name]
            for info in settings_module.describe(cls) if info.name in values
        })
        for concern, cls in _CONCERNS.items()
    })
    levels = config.curriculum
    if (levels.curriculum_final_level > 0) != (levels.curriculum_start_level > 0) or (
            levels.curriculum_start_level > levels.curriculum_final_level):
        raise ValueError(
            f'curriculum_start_level: got {levels.curriculum_start_level}, expected 1 to '
            f'curriculum_final_level, {levels.curriculum_final_level}, or both 0')
    if config.ppo.start_copies > 1 and levels.curriculum_start_reach:
        raise ValueError(
            f'start_copies: got {config.ppo.start_copies}, expected 1 with '
            f'curriculum_start_reach {levels.curriculum_start_reach:g}')
    for name in ('gamma_first', 'entropy_coefficient_final'):
        if -1 < (value := getattr(config.ppo, name)) < 0:
            raise ValueError(f'{name}: got {value:g}, expected -1, or 0 or more')
    warmup = config.ppo.critic_warmup_iterations
    if 0 < config.ppo.iterations <= warmup and not config.ppo.whole_episodes:
        raise ValueError(
            f'critic_warmup_iterations: got {warmup}, expected less than iterations, '
            f'{config.ppo.iterations}, or the policy would not learn')
    if levels.reach_is_fixed and (
            levels.curriculum_start_level < levels.curriculum_final_level):
        raise ValueError(
            f'curriculum_reach_landing_rate: got {levels.curriculum_reach_landing_rate:g}, '
            f'expected at most 1, as levels rise only after the reach: '
            f'curriculum_start_level {levels.curriculum_start_level}, '
            f'curriculum_final_level {levels.curriculum_final_level}')
    if levels.curriculum_wide_level and config.ppo.num_groups < 2:
        raise ValueError(
            f'num_groups: got {config.ppo.num_groups}, expected 2 or more with '
            f'curriculum_wide_level {levels.curriculum_wide_level}')
    network = config.network
    for name in ('log_std_init', 'log_std_final'):
        if getattr(network, name) < network.log_std_floor:
            raise ValueError(
                f'{name}: got {getattr(network, name)}, '
                f'expected at least log_std_floor, {network.log_std_floor}')
    if not network.hidden_sizes:
        raise ValueError('hidden_sizes: got none, expected at least one layer')
    return config


def fit_copies(config: Config, num_envs: int) -> Config:
    """Return the settings with copies of a start reduced to a divisor of a simulator's rockets."""
    copies = max(
        count for count in range(1, config.ppo.start_copies + 1) if not num_envs % count)
    return replace(config, ppo=replace(config.ppo, start_copies=copies))


def check_world(config: Config, spec: WorldSpec) -> None:
    """Check that a world has what the settings request, and the usual starts.

    :raises ValueError: naming the setting.
    """
    levels, final = 'level' in spec.settings, config.curriculum.curriculum_final_level
    if levels != (final > 0):
        raise ValueError(
            f'curriculum_final_level: got {final}, expected {"1 or more" if levels else 0}, as '
            f'world {spec.name!r} has {"" if levels else "no "}levels')
    for name in ('conditions', 'curriculum_wide_conditions', 'curriculum_nominal_share'):
        if drawn := getattr(config.curriculum, name):
            conditions.check_world(spec, drawn, name)
    if (drawn := config.curriculum.curriculum_wide_conditions) and (
            not config.curriculum.curriculum_wide_level):
        raise ValueError(
            f"curriculum_wide_conditions: got {drawn!r}, expected '' with "
            'curriculum_wide_level 0')
    seen = 'extended' if 'command_1_throttle' in spec.observation_names else 'standard'
    if 'observation' in spec.settings and config.curriculum.observation != seen:
        raise ValueError(
            f'observation: got {config.curriculum.observation!r}, but the simulator was started '
            f'with observation:={seen}; expected the same value for both')
    if 'observation' not in spec.settings and config.curriculum.observation != 'standard':
        raise ValueError(
            f"observation: got {config.curriculum.observation!r}, expected 'standard', as world "
            f'{spec.name!r} has no other')
    copies = config.ppo.start_copies
    if copies > 1 and 'spawn_copies' not in spec.settings:
        raise ValueError(
            f'start_copies: got {copies}, expected 1, as world {spec.name!r} has no spawn_copies')
    reach = config.curriculum.curriculum_start_reach
    if reach and 'spawn_reach' not in spec.settings:
        raise ValueError(
            f'curriculum_start_reach: got {reach:g}, expected 0, as world {spec.name!r} has no '
            'heights to start from')
    if own := spec.settings.get('spawn_reach'):
        raise ValueError(
            f'spawn_reach: got {own:g}, expected 0, as a training sets it by '
            'curriculum_start_reach')
    for name, value, unset in (
        ('curriculum_heading', config.curriculum.curriculum_heading, 0),
        ('demonstration_spawn_heading', config.demonstration.demonstration_spawn_heading, UNSET),
    ):
        if value != unset and 'spawn_heading' not in spec.settings:
            raise ValueError(
                f'{name}: got {value:g}, expected none, as world {spec.name!r} has no headings')
    if not levels:
        usual = DemonstrationConfig()
        for name in _STARTS_OF_LEVELS:
            value, default = getattr(config.demonstration, name), getattr(usual, name)
            if value != default:
                raise ValueError(
                    f'{name}: got {value:g}, expected {default:g}, the default, as world '
                    f'{spec.name!r} has no levels')
