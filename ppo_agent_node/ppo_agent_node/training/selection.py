# SPDX-License-Identifier: Apache-2.0
"""Selection of a run's best policy by evaluations without noise, always from the same starts."""
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
"""Starts a job of one episode per rocket."""


@dataclass(frozen=True)
class Score:
    """Evaluation results of a policy; the higher mean return is better."""

    iteration: int
    episodes: int
    landed: int
    mean_return: float

    @property
    def landing_rate(self) -> float:
        """Fraction of the episodes that landed."""
        return self.landed / self.episodes


def fly_wave(
    pilot: Pilot, settings: Mapping[str, float], seed: int, wave: int,
) -> Job[tuple[Episodes, int]]:
    """Fly one episode with each rocket; return the episodes and the number of steps.

    The starts depend on the run's seed and the wave alone, so two policies of a run have the same
    ones and their difference is less noisy than either. The final evaluation has other starts.
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
    """Fly at least `episodes` episodes from each kind of start, equally many with each rocket.

    :param starts: reset settings of the world, by kind.
    :param fly: runs jobs and yields the results, in order.
    :return: the score, and the rocket steps taken.
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
    """Result of an evaluation without noise."""

    score: Score
    better: bool
    """Whether the policy is better than all before."""
    steps: int
    """Rocket steps taken."""
    numbers: dict[str, Any]
    """Values for the log."""


class Selector:
    """Evaluates policies of a run without noise when due, and reports the results."""

    def __init__(
        self, spec: WorldSpec, config: Config, metrics: MetricsLogger,
        fly: Callable[[Sequence[Wave]], Iterable[tuple[Episodes, int]]],
    ) -> None:
        """Store the run's settings; `fly` runs jobs."""
        self._spec, self._config, self._metrics, self._fly = spec, config, metrics, fly

    def due(self, iteration: int, landing_rate: float, harder: bool) -> bool:
        """Return whether an evaluation of the policy is due, and worthwhile.

        :param landing_rate: see `RunState.landing_rate`.
        :param harder: whether the task has just become harder, which emptied the window.
        """
        config, least = self._config.run, self._config.run.selection_from_landing_rate
        return iteration % config.selection_interval == 0 and (
            harder or least == 0 or landing_rate >= least)

    def select(self, policy: Policy, iteration: int, best: Score | None) -> Selected:
        """Evaluate the policy of an iteration.

        :param best: the best score so far.
        """
        config = self._config
        score, steps = fly_selection(
            self._fly, self._spec, policy, iteration, config.curriculum.selection_settings,
            config.run.selection_episodes, config.run.seed)
        better = best is None or score.mean_return > best.mean_return
        low, high = wilson(score.landed, score.episodes)
        self._metrics.keep(
            selection_iteration=score.iteration, selection_landing_rate_low=low,
            selection_landing_rate_high=high, selection_return=score.mean_return,
            selection_landing_rate=score.landing_rate)
        self.tell(score if better else best)
        return Selected(score, better, steps, {
            'selection_return': score.mean_return, 'selection_landing_rate': score.landing_rate})

    def tell(self, best: Score | None) -> None:
        """Add the best policy, if there is one, to all further reports."""
        if best:
            self._metrics.keep(
                best_iteration=best.iteration, best_landing_rate=best.landing_rate,
                best_return=best.mean_return)
