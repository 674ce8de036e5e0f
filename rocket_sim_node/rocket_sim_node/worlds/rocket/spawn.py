# SPDX-License-Identifier: Apache-2.0
"""Initial states of the rocket worlds' episodes: curriculum levels and random draws."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds import random_streams
from rocket_sim_node.worlds import start_heights
from rocket_sim_node.worlds.rocket import rotation
from rocket_sim_node.worlds.rocket.vehicle import FROM_LEVEL
from rocket_sim_node.worlds.rocket.vehicle import TaskSettings

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class SpawnRange:
    """Half-widths of the uniform draws of one curriculum level."""

    angle: float
    """deg, pitch and roll."""
    position: float
    """m, x and z."""
    speed: float
    """m/s, x and z; y is from minus twice that to 0."""
    spin: float
    """rad/s, about each axis."""


LEVELS: dict[int, SpawnRange] = {
    1: SpawnRange(5.0, 0.0, 0.0, 0.0),
    2: SpawnRange(10.0, 0.0, 0.0, 0.0),
    3: SpawnRange(20.0, 0.0, 0.0, 0.0),
    4: SpawnRange(35.0, 0.0, 0.0, 0.0),
    5: SpawnRange(35.0, 3.0, 0.0, 0.0),
    6: SpawnRange(35.0, 5.0, 0.0, 0.0),
    7: SpawnRange(35.0, 5.0, 2.0, 0.0),
    8: SpawnRange(35.0, 50.0, 15.0, 0.3),
}

SPAWN_SETTINGS = ('spawn_angle', 'spawn_position', 'spawn_speed', 'spawn_spin')
CURRICULUM_SETTINGS = ('level', 'spawn_height', *SPAWN_SETTINGS, 'spawn_reach', 'spawn_copies')
"""Settings that a reset may change."""

_MAX_ATTEMPTS = 1000
_WIDEST = 4
_OUT_OF_PLANE = [1, 4, 5, 6, 8]
"""Out-of-plane entries of a draw's ten numbers: position z, velocity z, spin x and y, pitch."""


class Spawn(NamedTuple):
    """Initial states of K episodes."""

    position: F64
    """`(3, K)` m."""
    velocity: F64
    """`(3, K)` m/s."""
    attitude: F64
    """`(4, K)` quaternion."""
    spin: F64
    """`(3, K)` rad/s."""


def spawn_range(task: TaskSettings) -> SpawnRange:
    """Return the effective ranges: those of the level, unless set individually.

    :raises ValueError: when hardly any attitude in range would be within the tilt limit, or when
        the spawn lies outside the field.
    """
    level = LEVELS[task.level]
    chosen = {
        name.removeprefix('spawn_'): getattr(task, name)
        for name in SPAWN_SETTINGS
        if getattr(task, name) >= 0
    }
    merged = SpawnRange(**{**level.__dict__, **chosen})
    for name in SPAWN_SETTINGS:
        if FROM_LEVEL < getattr(task, name) < 0:
            raise ValueError(
                f'setting {name!r}: got {getattr(task, name)}, expected 0 or more, '
                f'or {FROM_LEVEL:g} for what the level says')
    if task.tilt_limit * _WIDEST < merged.angle:
        # Otherwise hardly any attitude drawn would be allowed, and an episode could not begin.
        raise ValueError(
            f"setting 'spawn_angle': got {merged.angle}, expected at most {_WIDEST} times "
            f'tilt_limit, {task.tilt_limit} deg')
    if merged.position > task.range_limit:
        raise ValueError(
            f"setting 'spawn_position': got {merged.position}, "
            f'expected at most range_limit, {task.range_limit} m'
        )
    if not task.touchdown_height < task.spawn_height <= task.height_limit:
        raise ValueError(
            f"setting 'spawn_height': got {task.spawn_height}, expected more than "
            f'touchdown_height, {task.touchdown_height} m, to height_limit, '
            f'{task.height_limit} m'
        )
    if task.spawn_reach > full_reach(vars(task)):
        raise ValueError(
            f"setting 'spawn_reach': got {task.spawn_reach}, expected at most spawn_height less "
            f'touchdown_height, {full_reach(vars(task)):g} m')
    return merged


def full_reach(settings: Mapping[str, float]) -> float:
    """Return the largest `spawn_reach`, m: the full drop of the task."""
    return settings['spawn_height'] - settings['touchdown_height']


def draw(
    seed: int,
    row: NDArray[np.integer],
    episode: NDArray[np.integer],
    ranges: SpawnRange,
    task: TaskSettings,
    in_plane: bool = False,
) -> Spawn:
    """Draw the initial states of episodes, each from its own random stream.

    An attitude beyond the tilt limit is drawn again, so that no episode starts terminated. Starts
    below `spawn_height`, see `spawn_reach`, are scaled with their height above touchdown. With
    `spawn_copies`, that many consecutive rockets share the first one's stream.

    :param row: `(K,)` rockets.
    :param episode: `(K,)` their episodes.
    :param in_plane: omit everything that leads out of the x-y plane; the rest is the same, except
        for attitudes that are drawn again.
    :raises ValueError: when no allowed attitude is found in 1 000 draws.
    """
    row = row // task.spawn_copies
    unit = random_streams.uniform(seed, row, episode, 10)
    if in_plane:
        unit[_OUT_OF_PLANE] = 0.0
    position = np.stack((unit[0] * ranges.position, np.full(len(row), task.spawn_height),
                         unit[1] * ranges.position))
    velocity = np.stack((unit[2] * ranges.speed, (unit[3] - 1.0) * ranges.speed,
                         unit[4] * ranges.speed))
    spin = unit[5:8] * ranges.spin
    angles = unit[8:10]
    half_width = np.full(len(row), np.deg2rad(ranges.angle))
    if task.spawn_reach:
        height = task.spawn_reach * start_heights.reach_share(seed, row, episode)
        part = height / full_reach(vars(task))
        position *= part
        position[1] = task.touchdown_height + height
        velocity *= part
        spin *= part
        half_width *= part
    attitude = rotation.from_pitch_roll(angles[0] * half_width, angles[1] * half_width)
    cos_limit = np.cos(np.deg2rad(task.tilt_limit))
    for attempt in range(1, _MAX_ATTEMPTS):
        again = np.flatnonzero(rotation.up_vector(attitude)[1] < cos_limit)
        if not again.size:
            return Spawn(position, velocity, attitude, spin)
        angles = random_streams.uniform(seed, row[again], episode[again], 2, attempt)
        if in_plane:
            angles[0] = 0.0
        attitude[:, again] = rotation.from_pitch_roll(
            angles[0] * half_width[again], angles[1] * half_width[again])
    raise ValueError(
        f"setting 'spawn_angle': no attitude within tilt_limit, {task.tilt_limit} deg, "
        f'in {_MAX_ATTEMPTS} draws of plus or minus {ranges.angle} deg'
    )


class SpawnStore:
    """Store of the initial states of each rocket's next episodes."""

    def __init__(
        self, seed: int, num_envs: int, ranges: SpawnRange, task: TaskSettings,
        in_plane: bool = False,
    ) -> None:
        """Create an empty store."""
        self._drawn = random_streams.DrawnAhead(num_envs, lambda rows, episodes: (
            np.concatenate(draw(seed, rows, episodes, ranges, task, in_plane)).T,))

    def take(self, row: NDArray[np.integer], episode: NDArray[np.integer]) -> Spawn:
        """Return the result of `draw` for `(K,)` rows and their episodes."""
        states = self._drawn.take(row, episode)[0].T
        return Spawn(states[0:3], states[3:6], states[6:10], states[10:13])
