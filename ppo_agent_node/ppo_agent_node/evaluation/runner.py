# SPDX-License-Identifier: Apache-2.0
"""Evaluation of a pilot over many episodes, without bias towards short ones."""
from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppo_agent_node.evaluation.optimum.fuel_bounds import StraightDropBound
from ppo_agent_node.evaluation.standing import Standing
from ppo_agent_node.evaluation.standing import after_touchdown
from ppo_agent_node.evaluation.standing import is_clipped
from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.flying.pilot import tell_begun
from rocket_sim_node import settings as settings_module
from rocket_sim_node import worlds
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import Episodes
from rocket_sim_node.worlds.base import VectorEnv
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import fly
from rocket_sim_node.worlds.lunar import vehicle
from rocket_sim_node.worlds.rocket import conditions
from rocket_sim_node.worlds.rocket.conditions import DRAWN_NAMES
from rocket_sim_node.worlds.rocket.drawn_vehicle import draw
from rocket_sim_node.worlds.rocket.vehicle import RocketSettings

IN_FLIGHT = ('tilt_limit', 'timeout', 'out_of_bounds')
"""Outcomes without a touchdown, or without its end (`timeout` of `rocket_planar`): their speed,
tilt and distance do not describe a landing."""

_VELOCITY_Y = 4
_PAD_X, _PAD_Z = 12, 14


@dataclass(frozen=True)
class EvaluationResult:
    """Results of an evaluation, `(K,)` episodes in order of row, then of flight."""

    spec: WorldSpec
    pilot: str
    seed: int
    reset_settings: dict[str, float]
    episodes: Episodes
    end_position: F64
    """`(K, 2)` m, x and z from the pad's centre at the end; NaN in unknown worlds."""
    first_observation: NDArray[np.float32]
    """`(K, D)` the first of each episode."""
    final_observation: NDArray[np.float32]
    """`(K, D)` the last of each episode."""

    @property
    def is_rocket(self) -> bool:
        """Whether the world has fuel."""
        return self.spec.name.startswith('rocket')

    @property
    def settings(self) -> dict[str, float]:
        """The world's settings during the evaluation."""
        return {**self.spec.settings, **self.reset_settings}

    @property
    def landed(self) -> NDArray[np.bool_]:
        """`(K,)` whether episodes landed."""
        return self.named('landed')

    @property
    def ground(self) -> NDArray[np.bool_]:
        """`(K,)` whether episodes ended on the ground."""
        return ~self.named(*IN_FLIGHT)

    @cached_property
    def fuel_bound(self) -> F64:
        """`(K,)` kg, minimum fuel of a straight drop from the start.

        NaN in other worlds, and if a `spawn_reach` lets the episodes begin at different heights.
        It takes up to a second to compute, so it is computed only on request.
        """
        if not self.is_rocket or self.settings['spawn_reach']:
            return np.full(len(self.episodes), np.nan)
        velocity = (self.first_observation[:, _VELOCITY_Y].astype(np.float64)
                    * self.spec.settings['velocity_scale'])
        return StraightDropBound(
            self.spec.settings, self.reset_settings.get('spawn_height')).fuel(velocity)

    @cached_property
    def settled(self) -> Standing | None:
        """Motion after touchdowns in world `rocket`; None in worlds that simulate it themselves.

        Also None if sensors are noisy or an observation of a touchdown is clipped, as the last
        observation does not give the final state then.
        """
        if self.spec.name != 'rocket' or self.settings.get('sensor_noise_high', 0) > 0:
            return None
        if is_clipped(self.final_observation[self.ground], self.settings):
            return None
        drawn = self._drawn()
        return after_touchdown(
            self.final_observation, self.episodes.fuel_left, self.ground, self.settings,
            drawn['dry_mass_factor'], drawn['gravity_factor'])

    def _drawn(self) -> dict[str, F64]:
        """Return the drawn conditions of the episodes in a world of rockets, `(K,)` each, by name.

        The world does not reveal them to pilots, but they follow from the seed.
        """
        flown = settings_module.build(
            RocketSettings, worlds.settings_from('rocket', self.settings))
        return dict(zip(DRAWN_NAMES, draw(
            self.seed, self.episodes.row // flown.spawn_copies, self.episodes.episode, flown),
            strict=True))

    @property
    def dry(self) -> NDArray[np.bool_] | None:
        """`(K,)` whether rockets ended with an empty tank; None in worlds without fuel."""
        return self.episodes.fuel_left <= 0.0 if self.is_rocket else None

    @property
    def standing(self) -> NDArray[np.bool_] | None:
        """`(K,)` whether rockets stand in the end; None if unknown."""
        if self.spec.name == 'rocket_planar':
            return self.landed
        return None if self.settled is None else self.settled.standing

    def named(self, *names: str) -> NDArray[np.bool_]:
        """Return `(K,)` whether episodes had one of these outcomes; unknown names match none."""
        codes = [code for code, name in enumerate(self.spec.outcomes) if name in names]
        return np.isin(self.episodes.outcome, codes)


def quotas(episodes: int, num_envs: int) -> NDArray[np.int64]:
    """Return how many episodes each rocket has to fly, `(N,)`: equal shares, the first one more.

    Counting the first episodes that end, regardless of the rocket, would favour short ones: while
    one rocket hovers for 30 s another crashes six times. With a share fixed in advance the length
    of an episode does not affect whether it counts. (stable-baselines3 found this bias in its
    evaluations and shares episodes in the same way, `evaluate_policy`.)

    :raises ValueError: for less than one episode or environment.
    """
    if episodes < 1 or num_envs < 1:
        raise ValueError(
            f'episodes, num_envs: got {episodes} and {num_envs}, expected 1 or more of each')
    share, more = divmod(episodes, num_envs)
    return share + (np.arange(num_envs) < more).astype(np.int64)


def evaluate(
    env: VectorEnv,
    pilot: Pilot,
    episodes: int = 2000,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    **reset_settings: Any,
) -> EvaluationResult:
    """Fly `episodes` episodes from a seed; equal arguments give equal results, bit for bit.

    Every rocket flies its share (see :func:`quotas`). One that has finished keeps flying until the
    last has finished; its further episodes are not counted.

    :param pilot: called once per step; no noise is added to its actions.
    :param progress: called with (episodes counted, total) when the count has changed.
    :param reset_settings: settings of the world that a reset may change, such as `level`; for
        rockets also `conditions`, the name of a set.
    :raises ValueError: for less than one episode, or settings that the world's reset refuses.
    :raises EnvironmentRestarted: the simulator was lost; call again for the same result.
    """
    return fly(env, evaluation_flight(
        env.spec, pilot, episodes, seed, progress, **reset_settings))


def evaluation_flight(
    spec: WorldSpec,
    pilot: Pilot,
    episodes: int,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
    **reset_settings: Any,
) -> Job[EvaluationResult]:
    """Do what `evaluate` does, as a job."""
    is_rocket = spec.name.startswith('rocket')
    if is_rocket:
        reset_settings = conditions.flatten(reset_settings)
    left = quotas(episodes, spec.num_envs)
    name = pilot.name  # first: a function without a name would fail after all flights
    observation = yield Reset(seed, reset_settings)
    start = observation.copy()
    counted: list[Episodes] = []
    starts: list[NDArray[np.float32]] = []
    ends: list[NDArray[np.float32]] = []
    done = 0
    pilot = copy.deepcopy(pilot)  # in its initial state, also when the job is restarted
    tell_begun(pilot)
    while done < episodes:
        observation, _, _, _, info = yield pilot(observation)
        rows: NDArray[np.int64] = info['final_rows']
        tell_begun(pilot, rows)
        if not len(rows):
            continue
        counts = left[rows] > 0
        counted.append(info['episodes'].take(counts))
        starts.append(start[rows[counts]])
        ends.append(info['final_observation'][counts])
        left[rows[counts]] -= 1
        start[rows] = observation[rows]
        done += len(counted[-1])
        if progress is not None and len(counted[-1]):
            progress(done, episodes)
    flown = Episodes.concatenate(counted)
    order = np.lexsort((flown.episode, flown.row))
    first, last = np.concatenate(starts)[order], np.concatenate(ends)[order]
    position = np.full((episodes, 2), np.nan)
    if is_rocket:
        position = (-last[:, [_PAD_X, _PAD_Z]].astype(np.float64)
                    * spec.settings['position_scale'])
    elif spec.name == 'lunar_lander':
        position[:, 0] = last[:, 0].astype(np.float64) * vehicle.HALF_WIDTH
        position[:, 1] = 0.0
    return EvaluationResult(
        spec=spec, pilot=name, seed=seed, reset_settings=dict(reset_settings),
        episodes=flown.take(order), end_position=position, first_observation=first,
        final_observation=last)
