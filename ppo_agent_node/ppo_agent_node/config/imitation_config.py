# SPDX-License-Identifier: Apache-2.0
"""Settings of demonstrations and cloning; see training_config for their use."""
from __future__ import annotations

from dataclasses import dataclass

from rocket_sim_node import settings as settings_module
from rocket_sim_node.settings import setting

UNSET = -1
"""Value of a `demonstration_spawn_*` setting that leaves the choice to the level."""


@dataclass(frozen=True)
class DemonstrationConfig:
    """Settings of the expert's demonstrations.

    The teacher is the expert with its own gains, unless gentler gains are given: without rounds
    of DAgger, a clone of a teacher that is easier to imitate lands more often.
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
    demonstration_spawn_heading: float = setting(
        float(UNSET), 'deg', "pilot's axes at spawn, plus or minus, rocket_planar only; "
        '-1: not turned', UNSET, 180.0)
    demonstration_spawn_reach: float = setting(
        float(UNSET), 'm', "height above touchdown up to which episodes begin: the world's "
        'spawn_reach, for all but those of curriculum_wide_level; -1: all begin at spawn_height',
        UNSET, 1e4)
    dagger_rounds: int = setting(
        0, '', 'rounds in which the clone flies, the expert says what it would have done, and '
        'cloning is repeated on all samples', 0, 1000)
    teacher: str = setting(
        '', '', "the scripted pilot that demonstrates; empty: the one for the world's engine",
        choices=('', 'expert', 'expert_estimator', 'hoverslam'))
    teacher_braking_share: float = setting(
        float(UNSET), '', "expert's planned deceleration, as a share of full throttle; -1: the "
        "expert's own", UNSET, 1.0)
    teacher_flare_rate: float = setting(
        float(UNSET), '1/s', "expert's speed per height in the flare; -1: the expert's own", UNSET,
        1000.0)
    teacher_flare_speed: float = setting(
        float(UNSET), 'm/s', "speed at touchdown that the expert aims at; -1: the expert's own",
        UNSET, 2.0)
    teacher_speed_settling: float = setting(
        float(UNSET), '', "time in which the expert's errors in speed die out, as a share of the "
        "burn left; -1: the expert's own", UNSET, 10.0)
    teacher_attitude_rate: float = setting(
        float(UNSET), 'rad/s', "natural frequency of the expert's attitude; -1: the expert's own",
        UNSET, 50.0)

    def teacher_gains(self) -> dict[str, float]:
        """Return the teacher's gains, by the expert's names."""
        return {
            name.removeprefix('teacher_'): value
            for name, value in settings_module.as_dict(self).items()
            if name.startswith('teacher_') and value != UNSET
        }


@dataclass(frozen=True)
class CloneConfig:
    """Settings of behavioural cloning."""

    clone_epochs: int = setting(
        12, '', 'passes over the demonstrations, at most; with DAgger those of the last round',
        1, 10_000)
    dagger_epochs: int = setting(
        4, '', 'passes before each round of DAgger, at most', 1, 10_000)
    clone_batch_size: int = setting(1024, '', 'samples in a minibatch', 1, 1_000_000)
    clone_learning_rate: float = setting(2e-3, '', 'of Adam, decays to 0', 0.0, 1.0)
    clone_huber_delta: float = setting(
        0.0, '', 'errors of an action count squared up to it and linearly beyond; 0: all squared',
        0.0, 2.0)
    clone_margin: float = setting(
        0.0, '', 'actions at a bound are aimed at from so far beyond, so that small errors do not '
        'leave it', 0.0, 2.0)
    clone_validation_fraction: float = setting(
        0.1, '', 'part of the episodes held out to validate', 0.0, 0.9)
    clone_patience: int = setting(
        5, '', 'epochs without a better validation loss before cloning stops', 1, 10_000)
