# SPDX-License-Identifier: Apache-2.0
"""The expert that identifies its vehicle: estimates, predictions, filter and landings."""
from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ppo_agent_node.evaluation.metrics import summarise
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.estimator.estimator import ExpertEstimator
from ppo_agent_node.pilots.estimator.kalman import AxisFilter
from ppo_agent_node.pilots.estimator.kalman import turn
from ppo_agent_node.pilots.expert.expert import ExpertPilot
from ppo_agent_node.pilots.expert.lateral import drift_upright
from ppo_agent_node.pilots.expert.observed_state import ObservedState
from ppo_agent_node.pilots.expert.observed_state import look
from rocket_sim_node import worlds
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.rocket import rotation

DT = 0.02


def _fly(rows: int, pilot: type[ExpertPilot] = ExpertEstimator, level: int = 7,
         world: str = 'rocket', **settings: Any) -> dict[str, Any]:
    env = worlds.make(world, rows, **settings)
    return summarise(evaluate(env, pilot(env.spec), rows, 11, level=level))


@pytest.mark.slow
@pytest.mark.parametrize(('conditions', 'landed', 'mean_return'), [
    ({}, 1.0, 295.1),
    ({'dry_mass_factor': 1.05, 'thrust_factor': 0.95}, 1.0, 294.5),
    ({'dry_mass_factor': 0.95}, 1.0, 295.0),
    ({'gravity_factor': 0.98}, 1.0, 294.8),
    ({'action_delay': 3}, 1.0, 295.0),
    ({'engine_lag': 0.2}, 1.0, 294.8),
    ({'side_acceleration': 1.0}, 1.0, 291.0),
    ({'sensor_noise': 1.0}, 0.98, 276.0),
    ({'conditions': 'mix'}, 0.98, 289.0),
], ids=str)
def test_lands_vehicles_that_differ_from_their_settings(
    conditions: dict[str, Any], landed: float, mean_return: float,
) -> None:
    summary = _fly(100, **conditions)
    assert summary['landed'] >= landed * 100, summary['outcomes']
    assert summary['mean_return'] > mean_return


def test_lands_in_the_plane() -> None:
    assert _fly(60, world='rocket_planar', conditions='mix')['landed'] >= 59


def test_the_plain_expert_loses_many_vehicles_of_the_mix() -> None:
    assert _fly(100, ExpertPilot, conditions='mix')['landed'] < 60


def test_finds_delay_lag_strength_turning_and_side_acceleration() -> None:
    world = worlds.make(
        'rocket', 20, seed=5, level=7, action_delay=2, engine_lag=0.1, dry_mass_factor=1.05,
        thrust_factor=0.95, rcs_factor=0.8, side_acceleration=0.5, gravity_factor=0.99)
    pilot, observation = ExpertEstimator(world.spec), world.observe()
    for _ in range(300):
        observation, *_ = world.step(pilot(observation))
    found, flown = pilot._found, world.telemetry(slice(None))
    assert (found.delay == 2).all()
    assert found.lag == pytest.approx(0.1)
    assert found.turning == pytest.approx(0.8, abs=1e-4)
    assert np.hypot(*found.side) == pytest.approx(0.5, abs=0.01)
    assert found.fall == pytest.approx(0.0981, abs=3e-3)
    # Fuel counts as it should: the strength is that of the mass and thrust at present.
    expected = 0.95 * (flown.fuel + 22_000) / flown.mass
    assert found.strength == pytest.approx(expected, rel=3e-3)


class Foreseeing(ExpertEstimator):
    """Keeps its predictions."""

    def _look(self, observation: F32) -> ObservedState:
        self.foreseen = super()._look(observation)
        return self.foreseen


def test_predicts_the_state_in_which_its_command_arrives() -> None:
    world = worlds.make('rocket', 10, seed=5, level=7, action_delay=3, engine_lag=0.1,
                        side_acceleration=0.5, thrust_factor=0.97)
    pilot, observation, foreseen = Foreseeing(world.spec), world.observe(), []
    for _ in range(330):
        action = pilot(observation)
        foreseen.append(pilot.foreseen)
        observation, *_ = world.step(action)
    seen, then = look(observation, world.spec.settings), foreseen[-3]
    assert then.height == pytest.approx(seen.height, abs=2e-3)
    assert then.velocity == pytest.approx(seen.velocity, abs=5e-3)
    assert then.up == pytest.approx(seen.up, abs=1e-4)
    assert then.spin == pytest.approx(seen.spin, abs=1e-4)


def test_a_reset_discards_the_estimates_of_past_flights() -> None:
    world = worlds.make('rocket', 12, seed=5, level=7, conditions='mix')
    pilot, observation = ExpertEstimator(world.spec), world.observe()
    for _ in range(250):
        observation, *_ = world.step(pilot(observation))
    first = world.reset(7)
    fresh = ExpertEstimator(world.spec)
    assert pilot(first).tolist() == fresh(first).tolist()
    assert pilot(first[:5]).tolist() == ExpertEstimator(world.spec)(first[:5]).tolist()


@pytest.mark.parametrize('time', [0.1, 0.3, 2.0])
def test_a_rocket_that_leans_less_and_less_comes_to_rest_upright(time: float) -> None:
    """Flown with what is left of the side acceleration, the way ends at rest on the axis."""
    side, upright_time, steps = np.array([[0.8], [-0.5]]), 0.3, 20_000
    way = drift_upright(side, np.array([time]), upright_time)
    x, drift, dt = way.x, way.drift, time / steps
    for step in range(steps):
        left = np.array([time - (step + 0.5) * dt])
        drift = drift + (side - drift_upright(side, left, upright_time).opposed) * dt
        x = x + drift * dt
    assert drift == pytest.approx(0.0, abs=1e-6)
    assert x == pytest.approx(0.0, abs=1e-4)


def test_an_axis_turns_as_that_of_the_world() -> None:
    generator = np.random.default_rng(1)
    attitude = generator.normal(size=(4, 30))
    attitude /= rotation.norm(attitude)
    spin = generator.normal(size=(3, 30))
    expected = rotation.up_vector(rotation.integrate(attitude, spin, DT))
    assert turn(rotation.up_vector(attitude), spin, DT) == pytest.approx(expected, abs=1e-12)


def test_the_filter_has_the_error_variance_that_it_claims() -> None:
    """Sample errors of 4 000 flights have the variance that the filter claims, to 10 %."""
    count, steps, truth = 4000, 100, 0.3
    generator, noise = np.random.default_rng(2), np.full(4000, 0.5)
    known = AxisFilter(1, count, DT, factor=0.0, spread=10.0)
    x, v = np.zeros((1, count)), np.zeros((1, count))
    rows = np.ones(count, bool)

    def seen() -> tuple[np.ndarray, np.ndarray]:
        return (x + 0.25 * generator.normal(size=x.shape),
                v + 0.1 * generator.normal(size=v.shape))

    known.begin(rows, *seen(), noise)
    for _ in range(steps):
        v = v + truth * DT
        x = x + v * DT
        known.predict(np.zeros((1, count)), np.ones(count), 0.0, 0.0)
        known.correct(*seen(), noise)
    for error, variance in (
        (known.position - x, known.covariance[0, 0]),
        (known.velocity - v, known.covariance[1, 1]),
        (known.factor - truth, known.covariance[2, 2]),
    ):
        assert error.mean() == pytest.approx(0.0, abs=4 * np.sqrt(variance[0] / count))
        assert error.var() == pytest.approx(variance[0], rel=0.1)
    # From speeds alone the slope of a line through 101 points of deviation 0.1 would be known to
    # 0.1 / (dt sqrt(sum k^2)); heights help a little.
    line = 0.1 / (DT * np.sqrt(101 * (101**2 - 1) / 12))
    assert 0.8 * line < np.sqrt(known.covariance[2, 2, 0]) < line
