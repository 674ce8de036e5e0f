# SPDX-License-Identifier: Apache-2.0
"""Settings of a training run: one dataclass per concern, one flat namespace.

Their names are also those of the ROS parameters, and the keys of presets and of a run's
`config.yaml`.
"""
from __future__ import annotations

import math
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


@dataclass(frozen=True)
class NetworkConfig:
    """Architecture and initialisation of actor and critic."""

    hidden_sizes: tuple[int, ...] = setting(
        (256, 256), '', 'units of the hidden layers, actor and critic alike', 1, 16_384)
    activation: str = setting(
        'tanh', '', 'what follows each hidden layer', choices=('tanh', 'relu'))
    fine_observations: str = setting(
        'pad_y', '', 'observations, by name, that are seen on a logarithmic scale away from zero; '
        'names that the world lacks are passed over')
    fine_width: float = setting(
        0.02, '', 'around zero, within this width, that scale is linear', 1e-9, 1e9)
    hidden_observations: str = setting(
        '', '', 'observations, by name, that the policy does not see and the critic does; names '
        'that the world lacks are passed over')
    features: str = setting(
        'none', '', 'what actor and critic see beside the observation; descent: needed '
        'deceleration, time to go, flare rate and what guidance weighs; miss: also where it would '
        'come down if nobody steered; worlds of rockets only',
        choices=('none', 'descent', 'miss'))
    log_std_init: float = setting(-2.8, '', 'log standard deviation to begin with', -10.0, 2.0)
    log_std_final: float = setting(
        -3.7, '', 'most it may be at the last iteration; the bound falls from log_std_init; '
        'log_std_init or more: no bound', -10.0, 20.0)
    log_std_floor: float = setting(-4.5, '', 'least log standard deviation', -10.0, 2.0)


@dataclass(frozen=True)
class PPOConfig:
    """Settings of proximal policy optimisation."""

    iterations: int = setting(70, '', 'roll-outs, each followed by an update', 0, 1_000_000)
    n_steps: int = setting(256, 'steps', 'length of a roll-out, per rocket', 1, 1_000_000)
    num_groups: int = setting(
        1, '', "batches of the simulator's num_envs rockets in a roll-out; each is flown by "
        'whichever simulator is free, so there should be as many as simulators, or more', 1, 4096)
    start_copies: int = setting(
        1, '', 'rockets that fly each start, in roll-outs of one whole episode a rocket: an '
        'advantage is the return of an episode beside those of its copies; fewer where num_envs '
        'is no multiple. 1: roll-outs of n_steps, judged by the critic', 1, 4096)
    scatter_steps: int = setting(
        512, 'steps', 'flown after a change of level to get the rockets out of step, about an '
        'episode; 0: not', 0, 1_000_000)
    n_epochs: int = setting(2, '', 'passes over a roll-out', 1, 1000)
    batch_size: int = setting(4096, '', 'samples in a minibatch', 1, 10_000_000)
    clip_range: float = setting(0.1, '', 'clip of the probability ratio, epsilon', 1e-6, 10.0)
    value_clip_range: float = setting(
        0.0, '', 'the critic is not rewarded for moving further than this from its old value, in '
        'its own units; 0: as far as it likes', 0.0, 1e9)
    gamma: float = setting(0.9999, '', 'discount per step', 0.0, 1.0)
    gamma_first: float = setting(
        -1.0, '', 'that of the first iteration, from where 1 - gamma goes to that of the last '
        'geometrically; -1: gamma throughout', -1.0, 1.0)
    gae_lambda: float = setting(0.99, '', 'lambda of generalised advantages', 0.0, 1.0)
    entropy_coefficient: float = setting(0.0, '', 'weight of the entropy bonus', 0.0, 100.0)
    entropy_coefficient_final: float = setting(
        -1.0, '', 'that at the end, to which it goes linearly; -1: the same throughout', -1.0,
        100.0)
    max_grad_norm: float = setting(
        0.5, '', 'gradients of each network are clipped to it', 1e-9, 1e9)
    actor_learning_rate: float = setting(3e-5, '', 'of Adam, at the first iteration', 0.0, 1.0)
    critic_learning_rate: float = setting(1e-3, '', 'of Adam, at the first iteration', 0.0, 1.0)
    log_std_learning_rate: float = setting(
        1e-3, '', 'of Adam for the log standard deviation, at the first iteration', 0.0, 1.0)
    learning_rate_decay: bool = setting(True, '', 'all rates fall linearly to 0 at the end')
    desired_kl: float = setting(
        0.0, 'nats', "after an update that moved the policy by over twice as much, the actor's "
        'learning rate is divided by 1.5, after one by less than half multiplied; 0: as it is',
        0.0, 1e3)
    target_kl: float = setting(
        0.03, 'nats', 'an update ends early beyond this divergence; 0: never', 0.0, 1e3)
    reward_scale: float = setting(0.01, '', 'the learner sees rewards times this', 1e-9, 1e9)
    normalise_advantages: bool = setting(
        True, '', 'advantages of a minibatch get mean 0 and standard deviation 1')
    critic_warmup_iterations: int = setting(
        12, '', 'first iterations that train the critic only', 0, 1_000_000)

    @property
    def whole_episodes(self) -> bool:
        """Whether a roll-out consists of whole episodes from new starts."""
        return self.start_copies > 1


@dataclass(frozen=True)
class RunConfig:
    """Settings of a run that do not concern learning."""

    seed: int = setting(1, '', 'all randomness of the run starts here', 0, 2**31 - 1)
    threads: int = setting(2, '', 'threads of the tensor library', 1, 1024)
    device: str = setting(
        'auto', '', 'where updates are computed; auto: on the GPU where there is one. On another '
        'device, also when a run is resumed there, the same seed gives other weights',
        choices=('auto', 'cpu', 'cuda'))
    checkpoint_interval: int = setting(
        5, 'iterations', 'a checkpoint is written this often, and at a stop', 1, 1_000_000)
    selection_interval: int = setting(
        5, 'iterations', 'the policy is flown without noise this often, to keep the best',
        1, 1_000_000)
    selection_from_landing_rate: float = setting(
        0.0, '', 'but only if so much of the last curriculum_window episodes of roll-outs landed',
        0.0, 1.0)
    selection_episodes: int = setting(
        512, '', 'episodes of such a flight, at least one per rocket', 1, 1_000_000)
    training_episodes: int = setting(
        0, 'episodes', 'fine-tuning also ends with the iteration in which so many have ended; '
        '0: after its iterations', 0, 1_000_000_000)
    target_return: float = setting(
        1e9, '', 'fine-tuning also ends with the iteration whose flight without noise returns so '
        'much on average; by default more than there is', -1e9, 1e9)
    episode_lines: bool = setting(
        False, '', 'tell of each episode of fine-tuning, its score and the average of the last '
        '50; keeps the scores in train.jsonl and draws them')
    evaluation_episodes: int = setting(
        2000, '', 'episodes of the final evaluation', 1, 10_000_000)
    evaluation_seed: int = setting(
        20_000_000, '', 'seed of the final evaluation, never used in training', 0, 2**31 - 1)


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
    copies = math.gcd(config.ppo.start_copies, num_envs)
    return replace(config, ppo=replace(config.ppo, start_copies=copies))


def check_world(config: Config, spec: WorldSpec) -> None:
    """Check that a world has the requested levels and headings.

    :raises ValueError: naming the setting.
    """
    levels, final = 'level' in spec.settings, config.curriculum.curriculum_final_level
    if levels != (final > 0):
        raise ValueError(
            f'curriculum_final_level: got {final}, expected {"1 or more" if levels else 0}, as '
            f'world {spec.name!r} has {"" if levels else "no "}levels')
    for name in ('conditions', 'curriculum_wide_conditions'):
        if drawn := getattr(config.curriculum, name):
            conditions.check_world(spec, drawn, name)
    seen = 'extended' if 'command_1_throttle' in spec.observation_names else 'standard'
    if 'observation' in spec.settings and config.curriculum.observation != seen:
        raise ValueError(
            f'observation: got {config.curriculum.observation!r}, but the simulator was started '
            f'with observation:={seen}; expected the same of both')
    copies = config.ppo.start_copies
    if copies > 1 and 'spawn_copies' not in spec.settings:
        raise ValueError(
            f'start_copies: got {copies}, expected 1, as world {spec.name!r} has no spawn_copies')
    reach = config.curriculum.curriculum_start_reach
    if reach and 'spawn_reach' not in spec.settings:
        raise ValueError(
            f'curriculum_start_reach: got {reach:g}, expected 0, as world {spec.name!r} has no '
            'heights to start from')
    for name, value, unset in (
        ('curriculum_heading', config.curriculum.curriculum_heading, 0),
        ('demonstration_spawn_heading', config.demonstration.demonstration_spawn_heading, UNSET),
    ):
        if value != unset and 'spawn_heading' not in spec.settings:
            raise ValueError(
                f'{name}: got {value:g}, expected none, as world {spec.name!r} has no headings')
