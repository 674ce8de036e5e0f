# SPDX-License-Identifier: Apache-2.0
"""Effects of conditions on a flight, against closed forms."""
from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rocket_sim_node import worlds
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.rocket import conditions
from rocket_sim_node.worlds.rocket.world import RocketWorld

DT = 0.02
STILL = {'spawn_angle': 0.0, 'spawn_position': 0.0, 'spawn_speed': 0.0, 'spawn_height': 350.0}
ALL = slice(None)


def make(name: str = 'rocket', num_envs: int = 1, **settings: Any) -> RocketWorld:
    """Return a world in which rockets begin upright and at rest."""
    world = worlds.make(name, num_envs, seed=5, **{**STILL, **settings})
    assert isinstance(world, RocketWorld)
    return world


def fly(world: RocketWorld, throttles: Any, rcs: tuple[float, float] = (0.0, 0.0)) -> F64:
    """Fly throttles `(T,)`, 0 to 1, and return those that were flown, `(T, N)`."""
    flown = []
    for throttle in throttles:
        world.step(np.tile([2 * throttle - 1, *rcs], (world.spec.num_envs, 1)))
        flown.append(world.telemetry(ALL).throttle)
    return np.array(flown)


def column(world: RocketWorld, name: str) -> F64:
    """Return what was drawn, `(N,)`."""
    return world.telemetry(ALL).conditions[:, conditions.DRAWN_NAMES.index(name)]


@pytest.mark.parametrize('lag', [0.05, 0.1, 0.3])
def test_the_engine_follows_as_a_first_order_system(lag: float) -> None:
    """Step responses at the ends of steps are exact: 1 - exp(-t / T), then exp(-t / T)."""
    flown = fly(make(engine_lag=lag), [1.0] * 20 + [0.0] * 20)[:, 0]
    rise = 1 - np.exp(-DT * np.arange(1, 21) / lag)
    fall = rise[-1] * np.exp(-DT * np.arange(1, 21) / lag)
    assert np.allclose(flown, [*rise, *fall], rtol=1e-12, atol=0)


def test_commands_arrive_as_many_steps_late_as_drawn() -> None:
    """Throttle and torques, exactly; engine off and no torque before the first."""
    world = make(num_envs=40, action_delay=(0, 5), rcs_torque=1e3)
    rng = np.random.default_rng(1)
    asked = rng.uniform(-1, 1, (30, 40, 3)) * (1.0, 0.1, 0.1)
    throttle, torque = np.zeros((30, 40)), np.zeros((30, 40, 3))
    for step, action in enumerate(asked):
        world.step(action)
        telemetry = world.telemetry(ALL)
        throttle[step], torque[step] = telemetry.throttle, telemetry.torque
        assert np.array_equal(telemetry.commanded_throttle, (action[:, 0] + 1) / 2)
    delay = column(world, 'action_delay').astype(int)
    assert set(delay) == set(range(6))
    for row, late in enumerate(delay):
        seen = asked[:30 - late, row]
        expected = (seen[:, 0] + 1) * 0.5
        expected[expected <= 0.01] = 0.0
        assert np.array_equal(throttle[late:, row], expected)
        assert np.array_equal(torque[late:, row, ::2], seen[:, 1:] * 1e3)
        assert not throttle[:late, row].any()
        assert not torque[:late, row].any()


def test_rockets_without_a_drawn_delay_fly_nominally() -> None:
    """Bit for bit, beside rockets with a delay."""
    late, nominal = make(num_envs=30, action_delay=(0, 1), level=8), make(num_envs=30, level=8)
    rows = column(late, 'action_delay') == 0
    assert 5 < rows.sum() < 25
    for action in np.random.default_rng(2).uniform(-1, 1, (60, 30, 3)) * (1, 0.02, 0.02):
        one, other = late.step(action)[0], nominal.step(action)[0]
        assert np.array_equal(one[rows], other[rows])
    assert (one[~rows] != other[~rows]).any(axis=1).all()


ASKED = [0.0, 0.05, 0.3, 0.8, 0.005, 0.0, 0.7, 0.2, 0.0, 0.9]


@pytest.mark.parametrize(('ignitions', 'expected'), [
    (0, [0, 0.6, 0.6, 0.8, 0, 0, 0.7, 0.6, 0, 0.9]),
    (1, [0, 0.6, 0.6, 0.8, 0, 0, 0, 0, 0, 0]),
    (2, [0, 0.6, 0.6, 0.8, 0, 0, 0.7, 0.6, 0, 0]),
])
def test_floor_and_ignitions(ignitions: int, expected: list[float]) -> None:
    """Lit it gives the floor at least; off, it costs an ignition to light it again."""
    world = make(throttle_floor=0.6, ignitions=ignitions, time_limit=len(ASKED) * DT)
    assert np.allclose(fly(world, ASKED)[:, 0], expected, rtol=0, atol=1e-15)
    episodes = world.step(np.array([[-1.0, 0.0, 0.0]]))[4]['episodes']
    assert episodes.ignitions.tolist() == [ignitions or 3]
    assert np.allclose(fly(world, [0.05])[:, 0], 0.6)  # the next episode has its own


def test_hoverslam_relights_nothing() -> None:
    """Off is off for the rest of the episode."""
    world = make(conditions='hoverslam')
    flown = fly(world, [0.5, 0.0] + [1.0] * 60)[:, 0]
    assert flown[0] == 0.6
    assert not flown[1:].any()


def test_the_floor_comes_before_the_lag_and_the_delay_before_both() -> None:
    """First the delay, then the floor, which the lagging engine makes for."""
    flown = fly(make(throttle_floor=0.5, engine_lag=0.1, action_delay=2), [0.1] * 12)[:, 0]
    expected = 0.5 * (1 - np.exp(-DT * np.arange(1, 11) / 0.1))
    assert np.allclose(flown, [0, 0, *expected], rtol=1e-12)


def test_an_empty_tank_gives_no_thrust_with_a_floor_or_a_lag() -> None:
    """The floor does not help, nor what a lagging engine still had."""
    for settings in ({'throttle_floor': 0.6}, {'engine_lag': 0.3}):
        world = make(fuel=10.0, **settings)
        fly(world, [1.0] * 60)
        assert world.fuel[0] == 0.0
        before = world.velocity[1, 0]
        assert not fly(world, [1.0])[0].any()
        assert world.velocity[1, 0] < before - 0.9 * 9.81 * DT


@pytest.mark.parametrize('factors', [
    {}, {'dry_mass_factor': 1.05}, {'thrust_factor': 0.95}, {'isp_factor': 0.97},
    {'gravity_factor': 1.02}, {'fuel_factor': 0.9},
    {'dry_mass_factor': 0.92, 'thrust_factor': 1.08, 'isp_factor': 0.95, 'fuel_factor': 0.95,
     'gravity_factor': 0.99},
], ids=str)
@pytest.mark.parametrize('name', ['rocket', 'rocket_planar'])
def test_the_rocket_equation_holds(name: str, factors: dict[str, float]) -> None:
    """Tsiolkovsky's, in vacuum, less what gravity takes, after 4 s at full throttle.

    The exhaust's speed is that of standard gravity: another gravity changes weight alone.
    """
    world = make(name, substeps=20, air_density=0.0, spawn_height=200.0, **factors)
    by = {name: factors.get(name, 1.0) for name in (
        'dry_mass_factor', 'thrust_factor', 'isp_factor', 'gravity_factor', 'fuel_factor')}
    fly(world, [1.0] * 200)
    exhaust = 282 * 9.81 * by['isp_factor']
    burnt = 470_880 * by['thrust_factor'] / exhaust * 4.0
    fuel = 2_000 * by['fuel_factor']
    start = 22_000 * by['dry_mass_factor'] + fuel
    gained = exhaust * np.log(start / (start - burnt)) - 9.81 * by['gravity_factor'] * 4.0
    assert world.velocity[1, 0] == pytest.approx(gained, rel=2e-5)
    assert world.fuel[0] == pytest.approx(fuel - burnt, rel=1e-9)
    telemetry = world.telemetry(ALL)
    assert telemetry.mass[0] == pytest.approx(start - burnt, rel=1e-9)
    assert telemetry.thrust[0] == pytest.approx(470_880 * by['thrust_factor'], rel=1e-12)


def test_rcs_turns_as_much_less_as_drawn() -> None:
    """Angular velocity is torque times time over inertia."""
    world = make(num_envs=20, rcs_factor=(0.7, 1.0))
    fly(world, [0.0] * 10, rcs=(0.02, -0.01))
    factor = column(world, 'rcs_factor')
    assert 0.7 <= factor.min() < 0.8 < factor.max() <= 1.0
    assert np.allclose(world.spin[0], 0.02 * 2e6 * factor * 0.2 / 5e5, rtol=1e-12)
    assert np.allclose(world.spin[2], -0.01 * 2e6 * factor * 0.2 / 5e5, rtol=1e-12)


def test_drag_follows_the_air_density() -> None:
    """Half the density times coefficient, area and speed squared."""
    world = make(air_density_factor=1.5, gravity=0.0)
    world.velocity[:, 0] = 12.0, -30.0, 4.0
    before = world.velocity.copy()
    fly(world, [0.0])
    drag = 0.5 * 1.225 * 1.5 * 0.30 * 10.8 * np.linalg.norm(before) * before / 24_000
    assert np.allclose(world.velocity - before, -drag * DT, rtol=1e-9)


@pytest.mark.parametrize('name', ['rocket', 'rocket_planar'])
def test_wind_blows_through_the_drag_law(name: str) -> None:
    """As if the rocket flew the other way; in the plane, with the part along it."""
    world = make(name, 50, wind_speed=20.0, gravity=0.0)
    world.velocity[1] = -10.0
    fly(world, [0.0])
    angle = column(world, 'wind_direction')
    across = np.sin(angle) if name == 'rocket' else 0.0 * angle
    relative = np.array([-20.0 * np.cos(angle), np.full(50, -10.0), -20.0 * across])
    drag = 0.5 * 1.225 * 0.30 * 10.8 * np.linalg.norm(relative, axis=0) * relative / 24_000
    assert np.allclose(world.velocity, [[0.0], [-10.0], [0.0]] - drag * DT, rtol=1e-9, atol=1e-12)
    world = make(name, 50, wind_speed=20.0, gravity=0.0)
    world.velocity[0], world.velocity[2] = 20.0 * np.cos(angle), 20.0 * across
    before = world.velocity.copy()
    fly(world, [0.0])
    assert np.allclose(world.velocity, before, atol=1e-12)  # it drifts along


@pytest.mark.parametrize('name', ['rocket', 'rocket_planar'])
def test_side_acceleration_is_constant_and_goes_anywhere(name: str) -> None:
    """Semi-implicit Euler: a t, and a t (t + dt) / 2; directions are uniform."""
    world = make(name, 400, side_acceleration=0.5, air_density=0.0)
    angle = column(world, 'side_direction')
    across = np.sin(angle) if name == 'rocket' else 0.0 * angle
    direction = np.array([np.cos(angle), across])
    fly(world, [0.0] * 50)
    assert np.allclose(world.velocity[::2], 0.5 * direction, atol=1e-12)
    assert np.allclose(world.position[::2], 0.5 * direction * 1.02 / 2, atol=1e-12)
    disturbance = world.telemetry(ALL).disturbance
    assert np.allclose(disturbance[:, ::2].T, 0.5 * direction, atol=1e-15)
    assert not disturbance[:, 1].any()
    quarters = np.bincount((angle / (np.pi / 2)).astype(int), minlength=4)
    assert np.abs(quarters - 100).max() < 5 * np.sqrt(400 * 0.25 * 0.75)


def test_gusts_are_coloured_noise() -> None:
    """Deviation 0.3 at all times, correlation exp(-t / 2 s), components independent.

    Bounds are five standard errors of 3 000 rockets.
    """
    count = 3000
    world = make(num_envs=count, gust_deviation=0.3)
    seen = [world.gust.copy()]
    for _ in range(100):
        fly(world, [0.5])
        seen.append(world.gust.copy())
    for gust in (seen[0], seen[1], seen[100]):
        assert np.abs(gust.mean(axis=1)).max() < 5 * 0.3 / np.sqrt(count)
        assert np.abs(gust.std(axis=1) / 0.3 - 1).max() < 5 / np.sqrt(2 * count)
        assert abs(np.corrcoef(gust)[0, 1]) < 5 / np.sqrt(count)
    for steps in (1, 50, 100):
        expected = np.exp(-steps * DT / 2.0)
        found = np.corrcoef(seen[0][0], seen[steps][0])[0, 1]
        assert abs(found - expected) < 5 * (1 - expected**2) / np.sqrt(count) + 1e-9


def test_gusts_push() -> None:
    """With the acceleration in the telemetry; there are none in nominal air."""
    world = make(num_envs=10, gust_deviation=(0.0, 0.3), side_acceleration=0.2, air_density=0.0)
    speed = np.zeros((10, 3))
    for _ in range(30):
        fly(world, [0.0])
        speed += world.telemetry(ALL).disturbance * DT
    assert np.allclose(world.velocity[::2].T, speed[:, ::2], atol=1e-12)
    assert np.abs(speed[:, 0]).min() > 0
    assert not make().telemetry(ALL).disturbance.any()


@pytest.mark.parametrize('name', ['rocket', 'rocket_planar'])
def test_sensors_are_noisy_as_specified(name: str) -> None:
    """0.5 m, 0.2 m/s and 1 degree times the factor; within five standard errors of 4 000."""
    count, factor = 4000, 0.5
    world, true = (make(name, count, sensor_noise=noise, spawn_height=100.0)
                   for noise in (factor, 0.0))
    error = world.observe().astype(float) - true.observe()
    assert np.array_equal(world.observe(), world.observe())
    axes = [0, 2] if name == 'rocket' else [0]
    for first, unit in ((0, 0.5 / 50), (3, 0.2 / 20), (6, np.deg2rad(1.0))):
        for axis in (*axes, 1) if first < 6 else axes:
            assert abs(error[:, first + axis].mean()) < 5 * factor * unit / np.sqrt(count)
            assert error[:, first + axis].std() == pytest.approx(
                factor * unit, rel=5 / np.sqrt(2 * count))
    assert np.allclose(np.linalg.norm(world.observe()[:, 6:9], axis=1), 1, atol=1e-6)
    assert np.allclose(error[:, 12:15], -error[:, 0:3], atol=1e-6)
    assert not error[:, 9:12].any()
    assert (not error[:, 2::3].any()) == (name == 'rocket_planar')
    later = world.step(np.tile([-1.0, 0, 0], (count, 1)))[0]
    fresh = later.astype(float) - true.step(np.tile([-1.0, 0, 0], (count, 1)))[0]
    assert abs(np.corrcoef(fresh[:, 0], error[:, 0])[0, 1]) < 5 / np.sqrt(count)
    assert np.array_equal(world.position, true.position)  # what is seen is not where it is
