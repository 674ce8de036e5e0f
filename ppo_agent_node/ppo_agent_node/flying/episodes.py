# SPDX-License-Identifier: Apache-2.0
"""Flights other than roll-outs: whole episodes by a pilot, and spreading of phases.

These are parts of jobs, see `rocket_sim_node.worlds.jobs`: they continue from an observation.
"""
from __future__ import annotations

from collections.abc import Callable
from typing import Any
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ppo_agent_node.flying.pilot import tell_begun
from rocket_sim_node.worlds import Episodes
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.jobs import Job

Pilot = Callable[[F32], NDArray[Any]]


class Step(NamedTuple):
    """One step of a flight."""

    observation: F32
    """`(N, D)`, before the step."""
    action: NDArray[Any]
    """`(N, ...)`, the pilot's action."""
    flying: NDArray[np.bool_]
    """`(N,)`, whether the row's first episode had not ended before the step."""
    episodes: Episodes
    """First episodes that ended with the step."""
    ended: NDArray[np.int64]
    """`(K,)` rows in which an episode ended with the step, the first or a later one."""


def fly_once(
    observation: F32,
    pilot: Pilot,
    disturb: Callable[[NDArray[Any]], NDArray[Any]] = lambda action: action,
) -> Job[list[Step]]:
    """Fly until every rocket has ended its current episode, and return all steps.

    Rockets that end early fly on but no longer count, so that short episodes are not
    over-represented.

    :param observation: `(N, D)`, of the current state.
    :param pilot: notified of episodes that begin on the way.
    :param disturb: returns the applied action for the pilot's action.
    """
    steps: list[Step] = []
    flying = np.ones(len(observation), np.bool_)
    while flying.any():
        action = pilot(observation)
        before, was_flying = observation, flying
        observation, _, _, _, info = yield disturb(action)
        episodes: Episodes = info['episodes']
        ended: NDArray[np.int64] = info['final_rows']
        tell_begun(pilot, ended)
        flying = was_flying.copy()
        flying[ended] = False
        steps.append(Step(
            before, action, was_flying, episodes.take(was_flying[episodes.row]), ended))
    return steps


def scatter(
    spec: WorldSpec, observation: F32, pilot: Pilot, steps: int, rng: np.random.Generator,
) -> Job[F32]:
    """Fly so that rockets that started together are spread over all phases of an episode.

    Otherwise a roll-out shorter than an episode would contain one phase only, and the learner
    would forget the others. The pilot takes over each rocket at a time of its own, uniform over
    the flight. Until then it holds an extreme command, which quickly ends its episodes.

    :param steps: number of steps, about the length of an episode.
    :return: the last observation.
    """
    held: NDArray[Any]
    release = rng.integers(max(1, steps), size=spec.num_envs)
    if spec.continuous:
        extremes = np.array([spec.action_low, spec.action_high], np.float32)
        corner = rng.integers(2, size=(spec.num_envs, spec.action_size))
        held = extremes[corner, np.arange(spec.action_size)]
    else:
        held = rng.integers(spec.action_count, size=spec.num_envs)
    for step in range(steps):
        action = pilot(observation).copy()
        action[step < release] = held[step < release]
        observation = (yield action)[0]
    return observation
