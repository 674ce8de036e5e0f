# SPDX-License-Identifier: Apache-2.0
"""The settings of a training run: one dataclass a concern, one flat namespace of names.

The names become ROS parameters one to one, and the keys of the presets and of a run's
`config.yaml`.
"""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
from dataclasses import fields
from importlib import resources
from typing import Any

import yaml

from rocket_sim_node import settings as settings_module
from rocket_sim_node.settings import SettingInfo
from rocket_sim_node.settings import setting

UNSET = -1
"""Value of a `demonstration_spawn_*` setting that leaves the choice to the level."""


@dataclass(frozen=True)
class DemonstrationConfig:
    """What the expert flies before the policy imitates it.

    The teacher is the expert with gentler gains than when it flies for itself: at its best it is
    too sharp to be imitated, and has no reserve to recover from noise with.
    """

    demonstration_episodes: int = setting(
        512, '', 'episodes that the expert flies; 0: neither demonstrations nor cloning',
        0, 1_000_000)
    demonstration_noise: float = setting(
        0.2, '', 'standard deviation of noise on the actions flown, not on those recorded',
        0.0, 2.0)
    demonstration_spawn_angle: float = setting(
        37.0, 'deg', 'pitch and roll at spawn, plus or minus; -1: by level', UNSET, 180.0)
    demonstration_spawn_position: float = setting(
        8.0, 'm', 'x and z at spawn, plus or minus; -1: by level', UNSET, 1e4)
    demonstration_spawn_speed: float = setting(
        3.5, 'm/s', 'velocity at spawn, x and z plus or minus, down to twice; -1: by level',
        UNSET, 1e3)
    demonstration_spawn_spin: float = setting(
        0.05, 'rad/s', 'angular velocity at spawn, plus or minus; -1: by level', UNSET, 100.0)
    teacher_braking_share: float = setting(
        0.8, '', "expert's planned deceleration, as a share of full throttle", 0.1, 1.0)
    teacher_flare_rate: float = setting(
        3.0, '1/s', "expert's speed per height in the flare", 0.5, 100.0)
    teacher_flare_speed: float = setting(
        0.1, 'm/s', 'speed at touchdown that the expert aims at', 1e-4, 2.0)
    teacher_speed_settling: float = setting(
        0.05, '', "time in which the expert's errors in speed die out, as a share of the burn "
        'left', 0.0, 10.0)
    teacher_attitude_rate: float = setting(
        24.0, 'rad/s', "natural frequency of the expert's attitude", 0.1, 50.0)

    def teacher_gains(self) -> dict[str, float]:
        """Return the gains that the teacher flies with, by the expert's names."""
        return {
            name.removeprefix('teacher_'): value
            for name, value in settings_module.as_dict(self).items()
            if name.startswith('teacher_')
        }


@dataclass(frozen=True)
class CloneConfig:
    """Behavioural cloning of the demonstrations."""

    clone_epochs: int = setting(12, '', 'passes over the demonstrations, at most', 1, 10_000)
    clone_batch_size: int = setting(1024, '', 'samples in a minibatch', 1, 1_000_000)
    clone_learning_rate: float = setting(2e-3, '', 'of Adam, decays to 0', 0.0, 1.0)
    clone_validation_fraction: float = setting(
        0.1, '', 'part of the episodes held out to validate', 0.0, 0.9)
    clone_patience: int = setting(
        5, '', 'epochs without a better validation loss before cloning stops', 1, 10_000)


@dataclass(frozen=True)
class NetworkConfig:
    """Shape and beginning of actor and critic."""

    hidden_sizes: tuple[int, ...] = setting(
        (256, 256), '', 'units of the hidden layers, actor and critic alike', 1, 16_384)
    fine_observations: str = setting(
        'pad_y', '', 'observations, by name, that are seen on a logarithmic scale away from zero; '
        'names that the world lacks are passed over')
    fine_width: float = setting(
        0.02, '', 'around zero, within this width, that scale is linear', 1e-9, 1e9)
    log_std_init: float = setting(-2.8, '', 'log standard deviation to begin with', -20.0, 2.0)
    log_std_final: float = setting(
        -3.7, '', 'most it may be at the last iteration; the bound falls from log_std_init; '
        'log_std_init or more: no bound', -20.0, 20.0)
    log_std_floor: float = setting(-4.5, '', 'least log standard deviation', -20.0, 2.0)


@dataclass(frozen=True)
class PPOConfig:
    """Proximal policy optimisation."""

    iterations: int = setting(70, '', 'roll-outs, each followed by an update', 0, 1_000_000)
    n_steps: int = setting(256, 'steps', 'length of a roll-out, per rocket', 1, 1_000_000)
    scatter_steps: int = setting(
        512, 'steps', 'flown after a change of level to get the rockets out of step, about an '
        'episode; 0: not', 0, 1_000_000)
    n_epochs: int = setting(2, '', 'passes over a roll-out', 1, 1000)
    batch_size: int = setting(4096, '', 'samples in a minibatch', 1, 10_000_000)
    clip_range: float = setting(0.1, '', 'clip of the probability ratio, epsilon', 1e-6, 10.0)
    gamma: float = setting(0.9999, '', 'discount per step', 0.0, 1.0)
    gae_lambda: float = setting(0.99, '', 'lambda of generalised advantages', 0.0, 1.0)
    entropy_coefficient: float = setting(0.0, '', 'weight of the entropy bonus', 0.0, 100.0)
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


@dataclass(frozen=True)
class CurriculumConfig:
    """When the task gets harder."""

    curriculum_start_level: int = setting(1, '', 'level of the first roll-out', 0, 8)
    curriculum_final_level: int = setting(
        7, '', 'level to end on, also that of evaluations; 0: the world has no levels', 0, 8)
    curriculum_landing_rate: float = setting(
        0.9, '', 'landing rate over the window that advances a level', 0.0, 1.0)
    curriculum_window: int = setting(
        64, 'episodes', 'the most recent that the landing rate is measured over', 1, 1_000_000)


@dataclass(frozen=True)
class RunConfig:
    """Everything about a run that is not about learning."""

    seed: int = setting(1, '', 'all randomness of the run starts here', 0, 2**31 - 1)
    threads: int = setting(2, '', 'threads of the tensor library', 1, 1024)
    checkpoint_interval: int = setting(
        5, 'iterations', 'a checkpoint is written this often, and at a stop', 1, 1_000_000)
    selection_interval: int = setting(
        5, 'iterations', 'the policy is flown without noise this often, to keep the best',
        1, 1_000_000)
    selection_episodes: int = setting(
        512, '', 'episodes of such a flight, at least one per rocket', 1, 1_000_000)
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
    if config.network.log_std_init < config.network.log_std_floor:
        raise ValueError(
            f'log_std_init: got {config.network.log_std_init}, '
            f'expected at least log_std_floor, {config.network.log_std_floor}')
    if not config.network.hidden_sizes:
        raise ValueError('hidden_sizes: got none, expected at least one layer')
    return config


def preset_names() -> tuple[str, ...]:
    """Return the names of the presets that ship with the package."""
    folder = resources.files('ppo_agent_node') / 'presets'
    return tuple(sorted(
        item.name.removesuffix('.yaml') for item in folder.iterdir()
        if item.name.endswith('.yaml')))


def preset_values(name: str) -> dict[str, Any]:
    """Return the values that a preset sets, by name, unchecked.

    :raises ValueError: when there is no such preset.
    """
    if name not in preset_names():
        raise ValueError(f'unknown preset {name!r}, expected one of {", ".join(preset_names())}')
    text = (resources.files('ppo_agent_node') / 'presets' / f'{name}.yaml').read_text('utf-8')
    values = yaml.safe_load(text)
    return dict(values)


def load_preset(name: str, **overrides: object) -> Config:
    """Return the settings of a preset, some of them overridden.

    :raises ValueError: for an unknown preset or setting, or a value out of range.
    :raises TypeError: for a value of another kind.
    """
    return make_config({**preset_values(name), **overrides})
