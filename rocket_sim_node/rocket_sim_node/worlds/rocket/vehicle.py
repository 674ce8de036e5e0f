# SPDX-License-Identifier: Apache-2.0
"""Constants of the rocket and its task, each a setting with unit and range."""
from __future__ import annotations

from dataclasses import dataclass

from rocket_sim_node.settings import setting
from rocket_sim_node.worlds.rocket.conditions import ConditionSettings

FROM_LEVEL = -1.0
"""Value of a `spawn_*` setting that leaves the choice to `level`."""


@dataclass(frozen=True)
class VehicleSettings:
    """A first stage of 24 t with one engine and reaction control (RCS), in still air."""

    dt: float = setting(0.02, 's', 'simulated time per step', 1e-4, 0.1)
    substeps: int = setting(1, '', 'integration steps per step', 1, 1000)
    dry_mass: float = setting(22_000.0, 'kg', 'mass without fuel', 1.0, 1e7)
    fuel: float = setting(2_000.0, 'kg', 'fuel at spawn', 0.0, 1e7)
    max_thrust: float = setting(470_880.0, 'N', 'thrust at full throttle', 0.0, 1e9)
    specific_impulse: float = setting(282.0, 's', 'specific impulse', 1.0, 1e4)
    gravity: float = setting(9.81, 'm/s^2', 'gravity, also of specific impulse', 0.0, 100.0)
    throttle_cutoff: float = setting(
        0.01, '', 'throttle at or below which the engine is off', 0.0, 1.0)
    rcs_torque: float = setting(2e6, 'N m', 'full RCS torque about world X and Z', 0.0, 1e12)
    inertia: float = setting(
        5e5, 'kg m^2', 'moment of inertia, the same about all axes', 1.0, 1e12)
    yaw_damping: float = setting(
        0.05, '1/step', 'fraction of the yaw rate lost per step', 0.0, 1.0)
    air_density: float = setting(1.225, 'kg/m^3', 'density of the air', 0.0, 100.0)
    drag_coefficient: float = setting(0.30, '', 'drag coefficient', 0.0, 100.0)
    drag_area: float = setting(10.8, 'm^2', 'reference area of drag', 0.0, 1e4)


@dataclass(frozen=True)
class TaskSettings:
    """Initial states, limits and rewards of an episode."""

    level: int = setting(7, '', 'curriculum level of the start', 1, 8)
    spawn_height: float = setting(200.0, 'm', 'height at spawn', 0.0, 1e4)
    spawn_angle: float = setting(
        FROM_LEVEL, 'deg', 'range of pitch and roll at the start, plus or minus; -1: by '
        'level', -1, 180.0)
    spawn_position: float = setting(
        FROM_LEVEL, 'm', 'range of x and z at the start, plus or minus; -1: by level', -1, 1e4)
    spawn_speed: float = setting(
        FROM_LEVEL, 'm/s', 'range of the velocity at the start: x and z plus or minus, downwards '
        'up to twice as much; -1: by level', -1, 1e3)
    spawn_spin: float = setting(
        FROM_LEVEL, 'rad/s', 'range of the angular velocity at the start, plus or minus; -1: by '
        'level', -1, 100.0)
    spawn_reach: float = setting(
        0.0, 'm', 'maximum start height above touchdown: starts are uniform up to it, with angle, '
        'position, speed and spin in proportion; 0: all start at spawn_height', 0.0, 1e4)
    spawn_copies: int = setting(
        1, '', 'number of consecutive rockets that share start, conditions, gusts and noise, so '
        'that only their actions differ', 1, 16_384)
    touchdown_height: float = setting(
        5.2, 'm', "height of the rocket's origin when it stands", 0.0, 1e4)
    landed_speed: float = setting(3.0, 'm/s', 'maximum touchdown speed of a landing', 1e-6, 1e3)
    landed_tilt: float = setting(10.0, 'deg', 'maximum tilt of a landing', 1e-6, 180.0)
    landed_distance: float = setting(
        15.0, 'm', 'maximum distance from the pad of a landing', 1e-6, 1e4)
    tilt_limit: float = setting(45.0, 'deg', 'maximum tilt in flight; more is a crash', 0.0, 180.0)
    time_limit: float = setting(
        30.0, 's', 'maximum duration of a flight; a longer one is a crash', 1e-4, 1e5)
    height_limit: float = setting(400.0, 'm', 'maximum height; flying higher is a crash', 0.0, 1e5)
    range_limit: float = setting(
        200.0, 'm', 'maximum |x| and |z|; beyond them is a crash', 0.0, 1e5)
    reward_step: float = setting(-0.01, '', 'reward of each step', -1e6, 1e6)
    reward_crash: float = setting(-100.0, '', 'reward of a crash', -1e6, 1e6)
    reward_landed: float = setting(100.0, '', 'reward of a landing', -1e6, 1e6)
    reward_speed: float = setting(100.0, '', 'bonus of a landing with no speed', -1e6, 1e6)
    reward_tilt: float = setting(50.0, '', 'bonus of a landing with no tilt', -1e6, 1e6)
    reward_distance: float = setting(50.0, '', "bonus of a landing on the pad's centre", -1e6, 1e6)


@dataclass(frozen=True)
class ObservationSettings:
    """Scales and clipping of observations."""

    position_scale: float = setting(50.0, 'm', 'position that is observed as 1', 1e-6, 1e6)
    velocity_scale: float = setting(20.0, 'm/s', 'velocity that is observed as 1', 1e-6, 1e6)
    spin_scale: float = setting(10.0, 'rad/s', 'angular velocity that is observed as 1', 1e-6, 1e6)
    observation_limit: float = setting(
        5.0, '', 'bound to which observations are clipped', 1e-6, 1e6)
    observation: str = setting(
        'standard', '', '15 numbers, or extended by the last 5 actions and 2 accelerations',
        choices=('standard', 'extended'))
    acceleration_scale: float = setting(
        20.0, 'm/s^2', 'acceleration that is observed as 1', 1e-6, 1e6)


@dataclass(frozen=True)
class RocketSettings(ConditionSettings, ObservationSettings, TaskSettings, VehicleSettings):
    """All settings of world `rocket`."""
