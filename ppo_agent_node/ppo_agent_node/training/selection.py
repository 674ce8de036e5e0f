# SPDX-License-Identifier: Apache-2.0
"""Which policy of a run is the best: flown without noise, from the same starts each time."""
from __future__ import annotations

import functools
from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from typing import NamedTuple

from ppo_agent_node import random_streams
from ppo_agent_node.config.training_config import Config
from ppo_agent_node.flying.episodes import Pilot
from ppo_agent_node.flying.episodes import fly_once
from ppo_agent_node.ppo.policies.factory import Policy
from ppo_agent_node.ppo.policies.factory import without_noise
from ppo_agent_node.runs.metrics_logger import MetricsLogger
from ppo_agent_node.statistics import wilson
from rocket_sim_node.worlds import Episodes
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import Reset

Wave = Callable[[], Job[tuple[Episodes, int]]]
"""Begins a flight of one episode a rocket."""


@dataclass(frozen=True)
class Score:
    """How a policy did; the better one has the higher mean return."""

    iteration: int
    episodes: int
    landed: int
    mean_return: float

    @property
    def landing_rate(self) -> float:
        """Part of the episodes that landed."""
        return self.landed / self.episodes


def fly_wave(
    pilot: Pilot, settings: Mapping[str, float], seed: int, wave: int,
) -> Job[tuple[Episodes, int]]:
    """Fly one episode with each rocket; return them, and the steps that it took.

    The starts depend on the run's seed and the wave alone, so that two policies of a run meet the
    same ones and their difference is less noisy than either; the final evaluation has others.
    """
    observation = yield Reset(
        random_streams.derived_seed(seed, 'selection', wave), settings)
    steps = yield from fly_once(observation, pilot)
    return Episodes.concatenate([step.episodes for step in steps]), len(steps)


def fly_selection(
    fly: Callable[[Sequence[Wave]], Iterable[tuple[Episodes, int]]], spec: WorldSpec,
    policy: Policy, iteration: int, starts: Sequence[Mapping[str, float]],
    episodes: int, seed: int,
) -> tuple[Score, int]:
    """Fly at least so many episodes from each kind of starts, equally many with each rocket.

    :param starts: what the world is reset with.
    :param fly: flies what it is given and yields the results, in order.
    :return: the score, and the rocket steps that it took.
    """
    rockets = spec.num_envs
    waves = [
        functools.partial(fly_wave, without_noise(policy), settings, seed, wave)
        for settings in starts for wave in range(-(-episodes // rockets))]
    parts, lengths = zip(*fly(waves), strict=True)
    flown = Episodes.concatenate(list(parts))
    landed = int((flown.outcome == spec.outcomes.index('landed')).sum())
    return Score(
        iteration, len(flown), landed, float(flown.episode_return.mean())), sum(lengths) * rockets


class Selected(NamedTuple):
    """A flight without noise, and what it says of the policy."""

    score: Score
    better: bool
    """than all before"""
    steps: int
    """of rockets, that it took"""
    numbers: dict[str, Any]
    """for the log"""


class Selector:
    """Flies the policies of a run without noise when that is due, and tells how they do."""

    def __init__(
        self, spec: WorldSpec, config: Config, journal: MetricsLogger,
        fly: Callable[[Sequence[Wave]], Iterable[tuple[Episodes, int]]],
    ) -> None:
        """Take the run, and who flies."""
        self._spec, self._config, self._journal, self._fly = spec, config, journal, fly

    def due(self, iteration: int, landing_rate: float) -> bool:
        """Tell whether the policy is due for such a flight, and worth one.

        :param landing_rate: of the last episodes of roll-outs; NaN before the first.
        """
        config, least = self._config.run, self._config.run.selection_from_landing_rate
        return iteration % config.selection_interval == 0 and (
            least == 0 or landing_rate >= least)

    def select(self, policy: Policy, iteration: int, best: Score | None) -> Selected:
        """Fly the policy of an iteration.

        :param best: the best score so far.
        """
        config = self._config
        score, steps = fly_selection(
            self._fly, self._spec, policy, iteration, config.curriculum.selection_settings,
            config.run.selection_episodes, config.run.seed)
        better = best is None or score.mean_return > best.mean_return
        low, high = wilson(score.landed, score.episodes)
        self._journal.keep(
            selection_iteration=score.iteration, selection_landing_rate_low=low,
            selection_landing_rate_high=high, selection_return=score.mean_return,
            selection_landing_rate=score.landing_rate)
        self.tell(score if better else best)
        return Selected(score, better, steps, {
            'selection_return': score.mean_return, 'selection_landing_rate': score.landing_rate})

    def tell(self, best: Score | None) -> None:
        """Let all reports from now on say which policy is the best, where there is one."""
        if best:
            self._journal.keep(
                best_iteration=best.iteration, best_landing_rate=best.landing_rate,
                best_return=best.mean_return)
