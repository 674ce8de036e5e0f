# SPDX-License-Identifier: Apache-2.0
"""Tuning: gains as points, their scores, and a search for better ones."""
from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from ppo_agent_node.evaluation.tuning import GainSpace
from ppo_agent_node.evaluation.tuning import Task
from ppo_agent_node.evaluation.tuning import judge
from ppo_agent_node.evaluation.tuning import search
from ppo_agent_node.pilots.expert.expert import ExpertPilot
from ppo_agent_node.pilots.expert.expert import ExpertSettings
from ppo_agent_node.pilots.scripted import scripted_pilot
from rocket_sim_node import worlds


class RandomSearch:
    """The plainest optimiser: around the best so far."""

    population_size = 8

    def __init__(self, size: int) -> None:
        self.mean, self._cost = np.zeros(size), np.inf
        self._generator = np.random.default_rng(1)

    def ask(self) -> np.ndarray:
        return self.mean + self._generator.normal(0, 0.3, len(self.mean))

    def tell(self, solutions: list[tuple[np.ndarray, float]]) -> None:
        for point, cost in solutions:
            if cost < self._cost:
                self.mean, self._cost = point, cost


def test_a_point_is_the_logarithm_of_gains_within_their_bounds() -> None:
    space = GainSpace(ExpertSettings, ['flare_rate', 'braking_share'],
                      {'flare_rate': 10.0, 'tilt_cap': 20.0})
    assert space.gains(space.origin)['flare_rate'] == pytest.approx(10.0)
    gains = space.gains(np.array([np.log(2), 5.0]))
    assert gains['flare_rate'] == pytest.approx(20.0)
    assert (gains['braking_share'], gains['tilt_cap']) == (1.0, 20.0)
    inside, outside = (space.overshoot(np.array([0.0, x])) for x in (-0.1, 5.0))
    assert inside == 0.0
    assert outside == pytest.approx((np.log(ExpertSettings().braking_share) + 5.0)**2)
    with pytest.raises(ValueError, match='courage'):
        GainSpace(ExpertSettings, ['courage'], {})


def test_a_search_finds_the_optimum_of_a_parabola() -> None:
    space = GainSpace(ExpertSettings, ['flare_rate', 'lateral_power'],
                      {'flare_rate': 30.0, 'lateral_power': 4.0})

    def worth(gains: dict[str, float]) -> float:
        return -np.log(gains['flare_rate'] / 50)**2 - np.log(gains['lateral_power'] / 6)**2

    found = list(islice(search(space, worth, RandomSearch(2)), 60))
    assert found[-1].best['flare_rate'] == pytest.approx(50, rel=0.05)
    assert found[-1].best['lateral_power'] == pytest.approx(6, rel=0.05)
    assert found[-1].flown == 480
    best = [generation.best_return for generation in found]
    assert best == sorted(best)


@pytest.mark.slow
def test_gains_are_judged_on_the_same_starts_and_never_those_of_an_evaluation() -> None:
    world = worlds.make('rocket', 8, spawn_height=40.0)
    worth = judge([Task(world, 1, 1000), Task(world, 3, 1001, weight=0.5)],
                  lambda spec, gains: ExpertPilot(spec, **gains))
    assert worth({}) == worth({})
    assert worth({'flare_speed': 0.1}) < worth({}) - 2
    for seed in (0, 999, 1_000_000, 20_000_000):
        with pytest.raises(ValueError, match='seed'):
            Task(world, 7, seed)


@pytest.mark.slow
def test_returns_are_weighted() -> None:
    world = worlds.make('rocket', 8, spawn_height=40.0)
    pilot = scripted_pilot(world.spec)
    first, second = Task(world, 1, 1000), Task(world, 7, 1001, weight=3.0)
    expected = (first.mean_return(pilot) + 3 * second.mean_return(pilot)) / 4
    assert judge([first, second], lambda spec, gains: pilot)({}) == pytest.approx(expected)
