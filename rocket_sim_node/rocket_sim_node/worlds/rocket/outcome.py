# SPDX-License-Identifier: Apache-2.0
"""Outcomes and terminal rewards of the rocket worlds."""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.telemetry.quantities import NO_OUTCOME
from rocket_sim_node.worlds.rocket.vehicle import TaskSettings

F64 = NDArray[np.float64]

OUTCOMES = (
    'landed', 'too_fast', 'tipped', 'off_pad', 'tilt_limit', 'timeout', 'out_of_bounds',
)
LANDED, TOO_FAST, TIPPED, OFF_PAD, TILT_LIMIT, TIMEOUT, OUT_OF_BOUNDS = range(7)


def step_limit(task: TaskSettings, dt: float) -> int:
    """Return the maximum number of steps of an episode within the time limit."""
    return int(np.floor(task.time_limit / dt + 1e-9))


def judge_touchdown(speed: F64, tilt: F64, distance: F64, task: TaskSettings) -> NDArray[np.uint8]:
    """Return the outcomes of touchdowns, `(K,)`: the first that applies, in the order of OUTCOMES.

    :param speed: `(K,)` m/s.
    :param tilt: `(K,)` deg from vertical.
    :param distance: `(K,)` m from the pad's centre.
    """
    outcome = np.full(len(speed), LANDED, np.uint8)
    outcome[distance >= task.landed_distance] = OFF_PAD
    outcome[tilt >= task.landed_tilt] = TIPPED
    outcome[speed >= task.landed_speed] = TOO_FAST
    return outcome


def judge_contact(
    hull: NDArray[np.bool_], resting: NDArray[np.bool_], speed: F64, tilt: F64, distance: F64,
    task: TaskSettings,
) -> NDArray[np.uint8]:
    """Return the outcomes of touchdowns in worlds with contact, `(K,)`, as `judge_touchdown` does.

    :param hull: `(K,)` whether the hull touched the ground.
    :param resting: `(K,)` whether the rocket came to rest; if neither, its time is up.
    :param speed: `(K,)` m/s at first contact.
    :param tilt: `(K,)` deg from vertical, at the end.
    :param distance: `(K,)` m from the pad's centre, at the end.
    """
    outcome = np.where(resting, LANDED, TIMEOUT).astype(np.uint8)
    outcome[resting & (distance >= task.landed_distance)] = OFF_PAD
    outcome[hull | (resting & (tilt >= task.landed_tilt))] = TIPPED
    outcome[speed >= task.landed_speed] = TOO_FAST
    return outcome


def judge_flight(
    tilted: NDArray[np.bool_], late: NDArray[np.bool_], outside: NDArray[np.bool_],
) -> NDArray[np.uint8]:
    """Return the outcomes of rockets in flight, `(K,)`; NO_OUTCOME if the flight continues."""
    outcome = np.full(len(tilted), NO_OUTCOME, np.uint8)
    outcome[outside] = OUT_OF_BOUNDS
    outcome[late] = TIMEOUT
    outcome[tilted] = TILT_LIMIT
    return outcome


def terminal_reward(
    outcome: NDArray[np.uint8], speed: F64, tilt: F64, distance: F64, task: TaskSettings,
) -> F64:
    """Return the terminal rewards of episodes, `(K,)`, without the step cost.

    A landing earns more the slower, the more upright and the nearer to the centre it is. A value
    beyond its limit earns nothing (in worlds where such a rocket may still land).
    """
    landed = (
        task.reward_landed
        + np.maximum(1 - speed / task.landed_speed, 0.0) * task.reward_speed
        + np.maximum(1 - tilt / task.landed_tilt, 0.0) * task.reward_tilt
        + np.maximum(1 - distance / task.landed_distance, 0.0) * task.reward_distance
    )
    return np.where(outcome == LANDED, landed, task.reward_crash)
