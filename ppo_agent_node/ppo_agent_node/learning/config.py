# SPDX-License-Identifier: Apache-2.0
"""The settings of a training run: one dataclass a concern, one flat namespace of names.

The names become ROS parameters one to one, and the keys of the presets and of a run's
`config.yaml`. Presets are files of such names and values, for each world its own.
"""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
from dataclasses import fields
from importlib import resources
from typing import Any

import yaml

from ppo_agent_node.learning.features import KINDS
from ppo_agent_node.learning.imitation_config import UNSET
from ppo_agent_node.learning.imitation_config import CloneConfig
from ppo_agent_node.learning.imitation_config import DemonstrationConfig
from rocket_sim_node import settings as settings_module
from rocket_sim_node.settings import SettingInfo
from rocket_sim_node.settings import setting
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds import conditions

_PRESETS = resources.files('ppo_agent_node') / 'presets'
_CONDITIONS = ('', *conditions.NAMES)


@dataclass(frozen=True)
class NetworkConfig:
    """Shape and beginning of actor and critic."""

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
        choices=KINDS)
    log_std_init: float = setting(-2.8, '', 'log standard deviation to begin with', -10.0, 2.0)
    log_std_final: float = setting(
        -3.7, '', 'most it may be at the last iteration; the bound falls from log_std_init; '
        'log_std_init or more: no bound', -10.0, 20.0)
    log_std_floor: float = setting(-4.5, '', 'least log standard deviation', -10.0, 2.0)


@dataclass(frozen=True)
class PPOConfig:
    """Proximal policy optimisation."""

    iterations: int = setting(70, '', 'roll-outs, each followed by an update', 0, 1_000_000)
    n_steps: int = setting(256, 'steps', 'length of a roll-out, per rocket', 1, 1_000_000)
    num_groups: int = setting(
        1, '', "batches of the simulator's num_envs rockets in a roll-out; each is flown by "
        'whichever simulator is free, so there should be as many as simulators, or more', 1, 4096)
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
    target_kl: float = setting(
        0.03, 'nats', 'an update ends early beyond this divergence; 0: never', 0.0, 1e3)
    reward_scale: float = setting(0.01, '', 'the learner sees rewards times this', 1e-9, 1e9)
    normalise_advantages: bool = setting(
        True, '', 'advantages of a minibatch get mean 0 and standard deviation 1')
    critic_warmup_iterations: int = setting(
        12, '', 'first iterations that train the critic only', 0, 1_000_000)


def level_setting(level: int) -> dict[str, float]:
    """Return what a world is reset with for a curriculum level, nothing for 0: its own."""
    return {'level': level} if level else {}


@dataclass(frozen=True)
class CurriculumConfig:
    """When the task gets harder."""

    curriculum_start_level: int = setting(1, '', 'level of the first roll-out', 0, 8)
    curriculum_final_level: int = setting(
        7, '', 'level to end on, also that of evaluations; 0: the world has no levels', 0, 8)
    curriculum_wide_level: int = setting(
        0, '', "level that every second group of rockets flies in place of the curriculum's, and "
        'that selection and demonstrations fly as well, so that one policy masters both; needs '
        'num_groups of 2 or more; 0: none', 0, 8)
    conditions: str = setting(
        '', '', 'set of conditions that all episodes of the run draw from; empty: as the '
        'simulator was started', choices=_CONDITIONS)
    curriculum_wide_conditions: str = setting(
        '', '', 'set of conditions of those groups; empty: that of the others',
        choices=_CONDITIONS)
    observation: str = setting(
        'standard', '', 'what the policy sees of a rocket; extended: also its last commands and '
        'accelerations, which the simulator has to be started with',
        choices=('standard', 'extended'))
    curriculum_landing_rate: float = setting(
        0.9, '', 'landing rate over the window that advances a level', 0.0, 1.0)
    curriculum_window: int = setting(
        64, 'episodes', 'the most recent that the landing rate is measured over', 1, 1_000_000)
    curriculum_start_reach: float = setting(
        0.0, 'm', 'the reverse curriculum: first of all, roll-outs begin up to so high above '
        "touchdown, the world's spawn_reach, then ever higher; 0: at the spawn height", 0.0, 1e4)
    curriculum_reach_growth: float = setting(
        1.2, '', 'by this factor, when the highest starts land', 1.000001, 1e4)
    curriculum_reach_landing_rate: float = setting(
        0.95, '', 'landing rate over the window that is enough for it', 0.0, 1.0)
    curriculum_reach_hardest: float = setting(
        0.2, '', 'part of the starts, the highest, that this rate is of', 1e-3, 1.0)
    curriculum_heading: float = setting(
        0.0, 'deg', "roll-outs are flown in axes turned by up to it, plus or minus: the world's "
        'spawn_heading; rocket_planar only', 0.0, 180.0)

    @property
    def selection_settings(self) -> tuple[dict[str, float], ...]:
        """What the world is reset with to select a policy, one flight each."""
        plain = self.task_settings(self.curriculum_final_level)
        return (plain, self.wide_settings) if self.curriculum_wide_level else (plain,)

    @property
    def wide_settings(self) -> dict[str, float]:
        """What the world is reset with for what every second group flies."""
        return self.task_settings(
            self.curriculum_wide_level, self.curriculum_wide_conditions or self.conditions)

    def task_settings(self, level: int, drawn: str | None = None) -> dict[str, float]:
        """Return what the world is reset with for a level.

        :param drawn: the set of conditions, by default the run's.
        """
        name = self.conditions if drawn is None else drawn
        return {**(conditions.settings(name) if name else {}), **level_setting(level)}

    def reset_settings(self, level: int, group: int = 0) -> dict[str, float]:
        """Return what the world of a group is reset with for roll-outs."""
        wide = group % 2 and self.curriculum_wide_level
        settings = self.wide_settings if wide else self.task_settings(level)
        if self.curriculum_heading:
            settings['spawn_heading'] = self.curriculum_heading
        return settings


@dataclass(frozen=True)
class RunConfig:
    """Everything about a run that is not about learning."""

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
    """Return what can be set in a run, in order of concern; names are unique."""
    return tuple(
        info for concern in _CONCERNS.values() for info in settings_module.describe(concern))


def make_config(values: Mapping[str, object]) -> Config:
    """Make a run's settings from names and values, the rest by default.

    :raises ValueError: for an unknown name, a value out of range, or two that contradict.
    :raises TypeError: for a value of another kind.
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


def check_world(config: Config, spec: WorldSpec) -> None:
    """Check that levels and headings are asked of a world that has them, and of no other.

    :raises ValueError: naming the setting.
    """
    levels, final = 'level' in spec.settings, config.curriculum.curriculum_final_level
    if levels != (final > 0):
        raise ValueError(
            f'curriculum_final_level: got {final}, expected {"1 or more" if levels else 0}, as '
            f'world {spec.name!r} has {"" if levels else "no "}levels')
    drawn = config.curriculum.conditions
    if drawn and not set(conditions.FLAT_NAMES) <= set(spec.settings):
        raise ValueError(
            f'conditions: got {drawn!r}, expected none, as world {spec.name!r} has no conditions')
    seen = 'extended' if 'command_1_throttle' in spec.observation_names else 'standard'
    if 'observation' in spec.settings and config.curriculum.observation != seen:
        raise ValueError(
            f'observation: got {config.curriculum.observation!r}, but the simulator was started '
            f'with observation:={seen}; expected the same of both')
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


def preset_names(world: str | None = None) -> tuple[str, ...]:
    """Return the names of the presets that ship for a world, or for any."""
    return tuple(sorted({
        preset.name.removesuffix('.yaml') for folder in _PRESETS.iterdir()
        if folder.is_dir() and world in (None, folder.name)
        for preset in folder.iterdir() if preset.name.endswith('.yaml')}))


def preset_values(name: str, world: str) -> dict[str, Any]:
    """Return the values that a preset sets in a world, by name, unchecked.

    They lie in `presets/<world>/<name>.yaml`. The key `like` names a world whose preset of the
    same name comes first, or a preset by world and name, as in `rocket/from_scratch`.

    :raises ValueError: when there is no such preset.
    """
    known = preset_names(world)
    if name not in known:
        raise ValueError(
            f'unknown preset {name!r} of world {world!r}, '
            f'expected one of {", ".join(known) or "none"}')
    values = dict(yaml.safe_load((_PRESETS / world / f'{name}.yaml').read_text('utf-8')))
    like = values.pop('like', None)
    if not like:
        return values
    world, _, other = like.partition('/')
    return {**preset_values(other or name, world), **values}


def load_preset(name: str, world: str = 'rocket', **overrides: object) -> Config:
    """Return the settings of a world's preset, some of them overridden.

    :raises ValueError: for an unknown preset or setting, or a value out of range.
    :raises TypeError: for a value of another kind.
    """
    return make_config({**preset_values(name, world), **overrides})
