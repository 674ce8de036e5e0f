# SPDX-License-Identifier: Apache-2.0
"""Least fuel and least time against closed forms, the straight drop, and the world itself."""
from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from ppo_agent_node.evaluation.optimum.fuel_bounds import StraightDropBound
from ppo_agent_node.evaluation.optimum.optimiser import Landing
from ppo_agent_node.evaluation.optimum.optimiser import LandingOptimiser
from ppo_agent_node.evaluation.optimum.optimiser import Optimum
from rocket_sim_node import worlds
from rocket_sim_node.worlds.base import Episodes
from rocket_sim_node.worlds.rocket.world import RocketWorld

SETTINGS = worlds.make('rocket').spec.settings
DT, FULL, MASS = SETTINGS['dt'], SETTINGS['max_thrust'], SETTINGS['dry_mass'] + SETTINGS['fuel']
FULL_STEP = FULL / (SETTINGS['specific_impulse'] * SETTINGS['gravity']) * DT
"""kg, what a step at full throttle burns"""


@cache
def solved(
    x: float = 0.0, z: float = 0.0, velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    blocks: int = 60, **settings: float,
) -> Optimum:
    """Return the optimum of a start 200 m up."""
    optimum = LandingOptimiser({**SETTINGS, **settings}, blocks).solve(
        np.array([x, 200.0, z]), np.array(velocity))
    assert optimum is not None
    return optimum


def flight_time(bound: StraightDropBound, speed: np.ndarray) -> np.ndarray:
    """Return the durations of the bound's flights, `(K,)` s.

    Free fall with drag from v0 to v takes (artanh(k v) - artanh(k v0)) / (k g), where 1 / k is
    the terminal speed, sqrt(m g / c).
    """
    burn = bound.burn_time(speed)
    _, ignition_speed = bound._ignition(burn)
    k = np.sqrt(bound.drag / (bound.mass * bound.gravity))
    fall = (np.arctanh(k * ignition_speed) - np.arctanh(k * speed)) / k
    return fall / bound.gravity + burn


def test_a_straight_drop_is_the_closed_form_but_for_whole_steps() -> None:
    bound, speeds = StraightDropBound(SETTINGS), np.array([0.0, 4.0, 15.0, 28.0])
    drops = [solved(velocity=(0.0, -speed, 0.0)) for speed in speeds]
    # Up to a step more, in which gravity takes half of what full throttle would give.
    more = np.array([one.least_fuel.fuel for one in drops]) - bound.fuel(-speeds)
    assert (more > -0.1).all()
    assert (more < 0.5 * FULL_STEP + 0.3).all()
    assert np.array([one.least_time.steps for one in drops]) == pytest.approx(
        flight_time(bound, speeds) / DT + 0.5, abs=1.0)


def test_finer_steps_approach_the_closed_form() -> None:
    bound = StraightDropBound(SETTINGS)
    fine = solved(velocity=(0.0, -15.0, 0.0), blocks=120, dt=0.0025)
    least = bound.flow * bound.burn_time(np.array([15.0]))[0]
    assert fine.least_fuel.fuel == pytest.approx(least, abs=0.3)


def test_without_drag_and_mass_loss_the_optimum_is_the_textbook_formula() -> None:
    # Free fall to the speed V and braking at T/m - g over heights that add up to H, see
    # test_fuel_bounds; the whole flight takes V / g + V / (T/m - g).
    g, height = SETTINGS['gravity'], SETTINGS['spawn_height'] - SETTINGS['touchdown_height']
    net = FULL / MASS - g
    speed = math.sqrt(2 * height / (1 / g + 1 / net))
    best = solved(air_density=0.0, specific_impulse=1e4, dt=0.01, blocks=150)
    assert best.least_time.time[-1] == pytest.approx(speed / g + speed / net, rel=3e-3)
    flow = FULL / (1e4 * g)
    assert best.least_fuel.fuel == pytest.approx(flow * speed / net, rel=3e-3)


def test_fuel_and_time_grow_with_distance_and_ignore_its_direction() -> None:
    ways = [solved(x) for x in (0.0, 3.0, 10.0, 30.0)]
    for values in ([one.least_fuel.fuel for one in ways], [one.least_time.steps for one in ways]):
        assert values == sorted(values)
        assert values[-1] > values[0]
    turned = solved(-6.0, 8.0)
    assert turned.least_fuel.fuel == pytest.approx(ways[2].least_fuel.fuel, abs=1e-3)
    assert turned.least_time.steps == ways[2].least_time.steps


def test_a_drift_towards_the_pad_costs_less_than_one_away() -> None:
    towards, away = (solved(10.0, velocity=(v, 0.0, 0.0)) for v in (-2.0, 2.0))
    assert towards.least_fuel.fuel < away.least_fuel.fuel


def test_coarser_blocks_cost_hardly_more_than_a_thrust_for_each_step() -> None:
    velocity = (1.22, -0.33, -0.99)
    exact, coarse = (solved(2.18, -1.46, velocity, blocks=blocks).least_fuel
                     for blocks in (441, 60))
    assert coarse.steps == exact.steps
    assert -0.001 < coarse.fuel - exact.fuel < 0.04


def fly(landing: Landing) -> Episodes:
    """Let world `rocket` fly a landing, turned by hand to where its thrust points."""
    world = worlds.make('rocket', tilt_limit=60.0, throttle_cutoff=0.0, spawn_angle=0.0)
    assert isinstance(world, RocketWorld)
    world.position[:, 0], world.velocity[:, 0] = landing.position[0], landing.velocity[0]
    for thrust in landing.thrust:
        size = float(np.linalg.norm(thrust))
        # A remainder of the solver's rounding points anywhere.
        x, y, z = thrust / size if size > 1.0 else (0.0, 1.0, 0.0)
        half = math.sqrt(0.5 * (1 + y))
        world.attitude[:, 0] = 0.5 * z / half, 0.0, -0.5 * x / half, half
        throttle = 2 * size / FULL - 1
        episodes: Episodes = world.step(np.array([[throttle, 0.0, 0.0]]))[4]['episodes']
        if len(episodes):
            return episodes
    raise AssertionError('it is still in flight')


@pytest.mark.parametrize(('x', 'z', 'velocity'), [
    (0.0, 0.0, (0.0, 0.0, 0.0)), (2.18, -1.46, (1.22, -0.33, -0.99)),
    (-12.4, -31.4, (11.2, -6.9, -0.5)), (30.0, 40.0, (0.0, -5.0, 0.0))])
def test_the_world_flies_the_optimum_to_rest_on_the_pad(
        x: float, z: float, velocity: tuple[float, float, float]) -> None:
    """The dynamics of the world itself reproduce the planned landing."""
    optimum = solved(x, z, velocity)
    for landing in (optimum.least_fuel, optimum.least_time):
        (length,), (speed,), (distance,), (fuel,) = (getattr(fly(landing), name) for name in (
            'length', 'touchdown_speed', 'distance', 'fuel_used'))
        assert length == landing.steps
        assert speed == pytest.approx(0.01, abs=2e-3)
        assert distance < 1e-3
        # Actions are float32.
        assert fuel == pytest.approx(landing.fuel, abs=1e-3)


def test_a_landing_respects_the_vehicle_and_has_a_trajectory() -> None:
    optimum = solved(30.0, 40.0, (0.0, -5.0, 0.0))
    assert optimum.least_time.steps < optimum.least_fuel.steps
    assert optimum.least_time.fuel > optimum.least_fuel.fuel
    for landing in (optimum.least_fuel, optimum.least_time):
        steps = landing.steps
        assert landing.time == pytest.approx(DT * np.arange(steps + 1))
        assert landing.position.shape == landing.velocity.shape == (steps + 1, 3)
        assert landing.thrust.shape == (steps, 3)
        size = np.linalg.norm(landing.thrust, axis=1)
        assert size.max() == pytest.approx(FULL, rel=1e-6)
        lean = np.rad2deg(np.arccos(landing.thrust[:, 1] / size))[size > 1e-3 * FULL]
        assert lean.max() < SETTINGS['tilt_limit'] + 1e-3
        assert landing.fuel == pytest.approx(
            size.sum() / FULL * FULL_STEP, rel=1e-6)
        assert (landing.position[:-1, 1] > SETTINGS['touchdown_height']).all()


def test_the_optimum_burns_at_full_throttle_or_not_at_all() -> None:
    """The maximum principle: of 60 blocks only those with a switch are in between."""
    landing = solved(2.18, -1.46, (1.22, -0.33, -0.99)).least_fuel
    throttle = np.linalg.norm(landing.thrust, axis=1) / FULL
    between = (throttle > 1e-3) & (throttle < 0.999)
    assert between.mean() < 5 / 60
    assert 0.4 < (throttle >= 0.999).mean() < 0.6


@pytest.mark.parametrize('change', [
    {'max_thrust': 200_000.0}, {'fuel': 300.0}, {'time_limit': 8.0}], ids=str)
def test_a_vehicle_that_cannot_land_has_no_optimum(change: dict[str, float]) -> None:
    optimiser = LandingOptimiser({**SETTINGS, **change}, 30)
    assert optimiser.solve(np.array([0.0, 200.0, 0.0]), np.zeros(3)) is None


def test_one_start_after_another_gives_the_same_as_each_alone() -> None:
    optimiser = LandingOptimiser(SETTINGS)
    starts = [(np.array([x, 200.0, 0.0]), np.array([0.0, -x, 0.0])) for x in (1.0, 20.0, 3.0)]
    for start in starts:
        together, alone = optimiser.solve(*start), LandingOptimiser(SETTINGS).solve(*start)
        assert together is not None
        assert alone is not None
        assert together.least_time.steps == alone.least_time.steps
        assert together.least_fuel.fuel == pytest.approx(alone.least_fuel.fuel, abs=1e-3)


@pytest.mark.parametrize('change', [
    {'gravity': 0.0}, {'max_thrust': 0.0}, {'fuel': 0.0}], ids=str)
def test_vehicles_of_another_kind_are_refused_by_name(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=f'{next(iter(change))}: got '):
        LandingOptimiser({**SETTINGS, **change})


@pytest.mark.parametrize('change', [
    {'throttle_floor_low': 0.6, 'throttle_floor_high': 0.6}, {'engine_lag_high': 0.2}], ids=str)
def test_conditions_that_are_not_nominal_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match='conditions: got custom, expected nominal'):
        LandingOptimiser({**SETTINGS, **change})


@pytest.mark.parametrize(('height', 'speed', 'message'), [
    (5.2, 0.0, 'expected more than 5.2 m'), (200.0, np.nan, 'expected finite')])
def test_invalid_starts_are_refused(height: float, speed: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        LandingOptimiser(SETTINGS).solve(np.array([0.0, height, 0.0]), np.array([0.0, speed, 0.0]))
