# SPDX-License-Identifier: Apache-2.0
"""World `lunar_lander` against Gymnasium's LunarLander-v3, which it rebuilds on another engine."""
from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.lunar_heuristic import LunarHeuristic
from rocket_sim_node import worlds
from rocket_sim_node.worlds.lunar import spawn
from rocket_sim_node.worlds.lunar import vehicle as vehicle
from rocket_sim_node.worlds.lunar.world import LunarLanderWorld

pytest.importorskip('Box2D')
gymnasium = pytest.importorskip('gymnasium')

from benchmarks.evaluation import gymnasium_lander  # noqa: E402 - needs what is looked for above
from benchmarks.evaluation.intervals import difference  # noqa: E402

TOLERANCE = np.array((0.002, 0.002, 0.005, 0.005, 0.01, 0.03, 0, 0))
"""of observations after a second of free flight: Box2D's legs follow the hull at once, ours within
a few steps, and swing it meanwhile"""


class NoScatter:
    """Stands in for Gymnasium's generator: engines without dispersion."""

    def uniform(self, *args: Any, **kwargs: Any) -> float:
        return 0.0


def states(env: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return poses and velocities `(3, 3)` of our bodies when they are as Box2D's are."""
    hull = env.lander
    angle, spin = hull.angle, hull.angularVelocity
    up = np.array((-np.sin(angle), np.cos(angle)))
    ahead = vehicle.BODY_CENTRE - vehicle.HULL_CENTRE
    place = np.array(hull.position) + vehicle.BODY_CENTRE * up
    speed = np.array(hull.linearVelocity) + ahead * spin * np.array((-up[1], up[0]))
    pose, velocity = [[*place, angle]], [[*speed, spin]]
    for leg in (env.legs[1], env.legs[0]):
        pose.append([*leg.position, leg.angle])
        velocity.append([*leg.linearVelocity, leg.angularVelocity])
    placed = np.array(pose)
    placed[:, 0] -= vehicle.HALF_WIDTH
    return placed, np.array(velocity)


def make(**settings: Any) -> LunarLanderWorld:
    world = worlds.make('lunar_lander', 1, **settings)
    assert isinstance(world, LunarLanderWorld)
    return world


@pytest.mark.parametrize('continuous', [False, True])
@pytest.mark.parametrize('seed', range(6))
def test_free_flight_agrees(
    seed: int, continuous: bool, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From equal states and by equal actions, for a second: TOLERANCE."""
    monkeypatch.setattr(
        'rocket_sim_node.worlds.random_streams.numbers',
        lambda key, draws, first=0: np.zeros((draws, len(key))))
    env = gymnasium.make('LunarLander-v3', continuous=continuous).unwrapped
    env.reset(seed=seed)
    world = make(continuous=continuous)
    pose, velocity = states(env)
    world._lanes.place(np.array([0]), pose[None], velocity[None])
    env._np_random = NoScatter()
    rng = np.random.default_rng(seed)
    worst = np.zeros(8)
    for _ in range(50):
        action = rng.uniform(-1, 1, 2) if continuous else int(rng.integers(0, 4))
        theirs = env.step(action)[0]
        ours = world.step(np.array([action]))[0][0]
        worst = np.maximum(worst, np.abs(ours - theirs))
    assert (worst <= TOLERANCE).all(), worst


def test_starts_agree() -> None:
    """A start after Gymnasium's random push is that push, worked out for a rigid body."""
    env = gymnasium.make('LunarLander-v3').unwrapped
    for seed in range(20):
        env.reset(seed=seed)
        rng, _ = gymnasium.utils.seeding.np_random(seed)
        rng.uniform(0, 1, size=12)
        push = np.array((rng.uniform(-1000, 1000), rng.uniform(-1000, 1000))) / 1000

        unit = np.concatenate((np.zeros(12), push, np.zeros(2)))[:, None]
        flat = spawn.derive(unit, 0.02, 10.0, vehicle.DROP)[0]
        start_pose, start_velocity = flat[11:20].reshape(3, 3), flat[20:29].reshape(3, 3)
        pose, velocity = states(env)
        # Box2D's legs are still on their way to their places.
        assert start_velocity[0] == pytest.approx(velocity[0], abs=0.005)
        # As they get there they lift the hull by 6 mm, which a start here has not.
        assert start_pose[0] == pytest.approx(pose[0], abs=0.007)
        assert start_pose[1:] == pytest.approx(pose[1:], abs=0.015)


def test_terrain_agrees() -> None:
    """The same heights for the same numbers."""
    env = gymnasium.make('LunarLander-v3').unwrapped
    for seed in range(5):
        env.reset(seed=seed)
        rng, _ = gymnasium.utils.seeding.np_random(seed)
        unit = rng.uniform(-1, 1, size=12)
        theirs = [polygon[0][1] for polygon in env.sky_polys] + [env.sky_polys[-1][1][1]]
        assert spawn._terrain(unit[:, None])[0] == pytest.approx(theirs, abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize('continuous', [False, True])
def test_the_heuristic_pilot_has_the_same_scores(continuous: bool) -> None:
    """The interval of the difference of means over 100 episodes each holds 0, with 3 sigma.

    ./launch_scripts/bench heuristic compares more episodes.
    """
    world = worlds.make('lunar_lander', 20, seed=1, continuous=continuous)
    pilot = LunarHeuristic(world.spec)
    ours = evaluate(world, pilot, 100, 1).episodes.episode_return
    theirs = gymnasium_lander.fly(pilot, 100, 1, continuous).episode_return
    change, low, high = difference(ours, theirs)
    sigma = (high - low) / 3.92
    assert abs(change) < 3 * sigma, (ours.mean(), theirs.mean())
    assert ours.mean() > (270 if continuous else 190)


@pytest.mark.slow
def test_random_flights_last_as_long() -> None:
    """How often hull and legs touch decides it: stiff legs would make them much longer."""
    world = worlds.make('lunar_lander', 50, seed=1)
    rng = np.random.default_rng(0)

    def pilot(observation: NDArray[np.float32]) -> NDArray[Any]:
        return rng.integers(0, 4, len(observation))

    pilot.name = 'random'  # type: ignore[attr-defined]
    ours = evaluate(world, pilot, 200, 1).episodes  # type: ignore[arg-type]
    theirs = gymnasium_lander.fly(pilot, 200, 1)
    change, low, high = difference(ours.length.astype(float), theirs.length.astype(float))
    assert abs(change) < 3 * (high - low) / 3.92, (ours.length.mean(), theirs.length.mean())
    change, low, high = difference(ours.episode_return, theirs.episode_return)
    assert abs(change) < 3 * (high - low) / 3.92
