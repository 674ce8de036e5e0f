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
        512, '', 'number of episodes flown by the expert, above num_envs rounded up to a multiple '
        'of it, and maximum number used in a round of DAgger; with curriculum_wide_level, as many '
        'again from that level; 0: no demonstrations and no cloning', 0, 1_000_000)
    demonstration_noise: float = setting(
        0.2, '', 'standard deviation of the noise added to the actions flown; the recorded '
        'actions have none; continuous actions only',
        0.0, 2.0)
    demonstration_spawn_angle: float = setting(
        37.0, 'deg', 'range of pitch and roll at the start, plus or minus; -1: by '
        'level', UNSET, 180.0)
    demonstration_spawn_position: float = setting(
        8.0, 'm', 'range of x and z at the start, plus or minus; -1: by level', UNSET, 1e4)
    demonstration_spawn_speed: float = setting(
        3.5, 'm/s', 'range of the velocity at the start: x and z plus or minus, downwards up to '
        'twice as much; -1: by level',
        UNSET, 1e3)
    demonstration_spawn_spin: float = setting(
        0.05, 'rad/s', 'range of the angular velocity at the start, plus or minus; -1: by '
        'level', UNSET, 100.0)
    demonstration_spawn_heading: float = setting(
        float(UNSET), 'deg', "rotation of the pilot's axes at spawn, plus or minus; rocket_planar "
        'only; -1: not rotated', UNSET, 180.0)
    demonstration_spawn_reach: float = setting(
        float(UNSET), 'm', "maximum start height above touchdown (the world's spawn_reach) of all "
        'demonstrations but those of curriculum_wide_level; -1: all begin at the usual height',
        UNSET, 1e4)
    dagger_rounds: int = setting(
        0, '', 'number of DAgger rounds: the clone flies, the expert labels the states it visits, '
        'and cloning is repeated on all samples', 0, 1000)
    teacher: str = setting(
        '', '', "scripted pilot that demonstrates; empty: the world's own, for rockets the one "
        'for their engine',
        choices=('', 'expert', 'expert_estimator', 'hoverslam'))
    teacher_braking_share: float = setting(
        float(UNSET), '', "deceleration that the teacher plans, as a share of that at full "
        "throttle; -1: the teacher's own value", UNSET, 1.0)
    teacher_flare_rate: float = setting(
        float(UNSET), '1/s', "speed per height of the teacher in the flare; -1: the teacher's own "
        'value', UNSET,
        1000.0)
    teacher_flare_speed: float = setting(
        float(UNSET), 'm/s', "touchdown speed that the teacher aims at; -1: the teacher's own "
        'value',
        UNSET, 2.0)
    teacher_speed_settling: float = setting(
        float(UNSET), '', "time constant of the teacher's speed errors, as a fraction of the "
        "remaining burn; -1: the teacher's own value", UNSET, 10.0)
    teacher_least_settling: float = setting(
        float(UNSET), 's', "lower bound of the time constant of the teacher's speed errors; -1: "
        "the teacher's own value", UNSET, 10.0)
    teacher_attitude_rate: float = setting(
        float(UNSET), 'rad/s', "natural frequency of the teacher's attitude control; -1: the "
        "teacher's own value",
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
        12, '', 'maximum number of passes over the demonstrations; with DAgger, in the last round',
        1, 10_000)
    dagger_epochs: int = setting(
        4, '', 'maximum number of passes before each DAgger round', 1, 10_000)
    clone_batch_size: int = setting(1024, '', 'samples in a minibatch', 1, 1_000_000)
    clone_learning_rate: float = setting(2e-3, '', 'learning rate of Adam; decays to 0', 0.0, 1.0)
    clone_huber_delta: float = setting(
        0.0, '', 'width of the Huber loss: larger errors of an action count linearly; 0: squared '
        'error throughout; continuous actions only',
        0.0, 2.0)
    clone_margin: float = setting(
        0.0, '', 'distance beyond a bound to which targets on that bound are moved, so that small '
        'errors are clipped to the bound; continuous actions only', 0.0, 2.0)
    clone_validation_fraction: float = setting(
        0.1, '', 'fraction of the episodes held out for validation', 0.0, 0.9)
    clone_patience: int = setting(
        5, '', 'number of epochs without a better validation loss after which cloning '
        'stops', 1, 10_000)
