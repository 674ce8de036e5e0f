# SPDX-License-Identifier: Apache-2.0
"""World `rocket_planar`: flight as in `rocket`, touchdown, ends and rewards."""
from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import ppo_agent_node
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.pilots.expert.expert import ExpertPilot
from ppo_agent_node.pilots.policy import PolicyPilot
from rocket_sim_node import worlds
from rocket_sim_node.telemetry.capture import Telemetry
from rocket_sim_node.worlds import registry
from rocket_sim_node.worlds.base import Episodes
from rocket_sim_node.worlds.planar import contact_model
from rocket_sim_node.worlds.planar.vehicle import PlanarSettings
from rocket_sim_node.worlds.planar.world import RocketPlanarWorld
from rocket_sim_node.worlds.rocket import rotation
from rocket_sim_node.worlds.rocket import spawn
from rocket_sim_node.worlds.rocket.world import RocketWorld

F64 = NDArray[np.float64]

OUT_OF_PLANE = [2, 5, 8, 9, 10, 14]
"""Numbers of an observation."""
STATE = ('position', 'velocity', 'attitude', 'spin', 'fuel')
STANCE, HEIGHT = 6.7, 5.2


def make(num_envs: int = 1, seed: int = 0, **settings: Any) -> RocketPlanarWorld:
    world = worlds.make('rocket_planar', num_envs, seed, **settings)
    assert isinstance(world, RocketPlanarWorld)
    return world


def foot_height(angle: float) -> float:
    """Return the height of the origin at which the lower foot touches, m."""
    return float(STANCE * abs(np.sin(angle)) + HEIGHT * np.cos(angle))


def put(
    world: RocketPlanarWorld, row: int, x: float = 0.0, above: float = 0.005,
    velocity: tuple[float, float] = (0.0, 0.0), tilt: float = 0.0, spin: float = 0.0,
) -> None:
    """Put a rocket somewhere, its lower foot `above` the ground; tilt in deg, to the left."""
    angle = np.deg2rad(tilt)
    world.position[:, row] = (x, foot_height(angle) + above, 0.0)
    world.velocity[:, row] = (*velocity, 0.0)
    world.attitude[:, row] = (0.0, 0.0, np.sin(angle / 2), np.cos(angle / 2))
    world.spin[:, row] = (0.0, 0.0, spin)


def ends(
    world: RocketPlanarWorld, action: tuple[float, float, float] = (-1.0, 0.0, 0.0),
    steps: int = 400,
) -> tuple[Episodes, Telemetry, float]:
    """Fly until the only rocket's episode ends: that, its last state and the last reward."""
    for _ in range(steps):
        _, reward, terminated, truncated, info = world.step(np.array([action]))
        assert not truncated.any()
        if terminated[0]:
            return info['episodes'], world.finished, float(reward[0])
    raise AssertionError('no end')


def outcome(world: RocketPlanarWorld, episodes: Episodes) -> str:
    return world.spec.outcomes[episodes.outcome[0]]


# The contract


def test_pilots_get_the_same_interface_as_in_rocket() -> None:
    planar, rocket = make(3).spec, worlds.make('rocket', 3).spec
    for name in ('observation_names', 'action_names', 'continuous', 'action_low', 'action_high',
                 'action_idle', 'outcomes', 'dt', 'num_envs'):
        assert getattr(planar, name) == getattr(rocket, name)
    assert planar.name == 'rocket_planar'
    assert rocket.settings.items() <= planar.settings.items()
    assert registry.reset_settings('rocket_planar') == (
        *registry.reset_settings('rocket'), 'spawn_heading')


def test_settings_have_descriptions() -> None:
    infos = registry.settings('rocket_planar')
    assert {info.name for info in infos} == set(PlanarSettings.__dataclass_fields__)
    assert all(info.description for info in infos)


@pytest.mark.parametrize('level', range(1, 9))
def test_starts_are_those_of_rocket_within_the_plane(level: int) -> None:
    planar, rocket = make(500, seed=4, level=level), worlds.make('rocket', 500, 4, level=level)
    assert isinstance(rocket, RocketWorld)
    assert np.array_equal(planar.position[:2], rocket.position[:2])
    assert np.array_equal(planar.velocity[:2], rocket.velocity[:2])
    assert np.array_equal(planar.spin[2], rocket.spin[2])
    assert not planar.observe()[:, OUT_OF_PLANE].any()
    roll = 2 * np.rad2deg(np.arctan2(planar.attitude[2], planar.attitude[3]))
    assert 0.97 < np.abs(roll).max() / spawn.LEVELS[level].angle <= 1.0


def test_a_start_beyond_the_tilt_limit_is_drawn_again() -> None:
    world = make(500, level=4, tilt_limit=10.0)
    roll = 2 * np.rad2deg(np.arctan2(world.attitude[2], world.attitude[3]))
    assert 9.8 < np.abs(roll).max() <= 10.0
    assert not world.attitude[:2].any()


# Flight


@pytest.mark.parametrize('substeps', [1, 3])
def test_flight_is_that_of_rocket(substeps: int) -> None:
    """Bit for bit, until the first contact; action 1 is not flown."""
    count = 64
    planar = make(count, seed=2, level=8, substeps=substeps)
    rocket = worlds.make('rocket', count, seed=2, level=8, substeps=substeps)
    assert isinstance(rocket, RocketWorld)
    for name in STATE:
        getattr(rocket, name)[:] = getattr(planar, name)
    rng = np.random.default_rng(3)
    flying = np.ones(count, np.bool_)
    flown = 0
    for _ in range(600):
        action = rng.uniform(-1, 1, (count, 3)) * (1.0, 1.0, 0.2)
        seen, reward, ended, _, _ = planar.step(action)
        theirs = rocket.step(action * (1.0, 0.0, 1.0))
        flying &= ~ended & ~theirs[2]
        assert np.array_equal(seen[flying], theirs[0][flying])
        assert np.array_equal(reward[flying], theirs[1][flying])
        for name in STATE:
            assert np.array_equal(
                getattr(planar, name)[..., flying], getattr(rocket, name)[..., flying])
        assert not seen[:, OUT_OF_PLANE].any()
        flown += int(flying.sum())
    assert flown > 5000


@pytest.mark.parametrize(('changed', 'expected'), [
    ({'position': (0.0, 401.0)}, 'out_of_bounds'),
    ({'position': (201.0, 100.0)}, 'out_of_bounds'),
    ({'tilt': 46.0, 'position': (0.0, 100.0)}, 'tilt_limit'),
    ({'age': 1500, 'position': (0.0, 100.0)}, 'timeout'),
])
def test_the_limits_of_flight_are_those_of_rocket(
    changed: dict[str, Any], expected: str,
) -> None:
    world = make()
    put(world, 0, tilt=changed.get('tilt', 0.0))
    world.position[:2, 0] = changed['position']
    world.age[0] = changed.get('age', 0)
    episodes, _, reward = ends(world, steps=1)
    assert outcome(world, episodes) == expected
    assert reward == pytest.approx(-100.01)


# Touchdown


def test_a_landing_is_rewarded_by_its_first_contact() -> None:
    """And by the distance at which it stands in the end."""
    world = make()
    put(world, 0, x=3.0, velocity=(0.5, -1.0), tilt=4.0)
    episodes, last, reward = ends(world)
    assert outcome(world, episodes) == 'landed'
    speed, tilt = episodes.touchdown_speed[0], np.rad2deg(episodes.tilt[0])
    assert speed == pytest.approx(np.hypot(0.5, 1.0 + 9.81 * 0.02), abs=0.01)
    assert tilt == pytest.approx(4.0, abs=1e-9)
    assert episodes.distance[0] == pytest.approx(last.position[0, 0])
    assert 3.0 < episodes.distance[0] < 3.7
    assert reward == pytest.approx(
        -0.01 + 100 + (1 - speed / 3) * 100 + (1 - tilt / 10) * 50
        + (1 - episodes.distance[0] / 15) * 50)
    assert episodes.episode_return[0] == pytest.approx(reward - 0.01 * (episodes.length[0] - 1))
    assert last.contact.tolist() == [[True, True]]
    assert last.contact_force[0] == pytest.approx((0, 24_000 * 9.81, 0), rel=1e-3, abs=50.0)
    assert last.position[0, 1] == pytest.approx(HEIGHT, abs=0.0012)
    assert last.leg_angle.shape == (1, 2)
    assert last.terrain.shape == (1, 0)


def test_a_landing_needs_the_rest_time() -> None:
    world = make(rest_time=1.0)
    put(world, 0, above=0.0)
    episodes, _, _ = ends(world)
    assert 50 <= episodes.length[0] <= 65


@pytest.mark.parametrize(('how', 'settings', 'expected', 'steps'), [
    ({'velocity': (0.0, -3.1)}, {}, 'too_fast', 1),
    ({'velocity': (3.1, -0.1)}, {}, 'too_fast', 1),
    ({'x': 16.0}, {}, 'off_pad', 400),
    ({'x': 14.9, 'velocity': (2.5, -0.5)}, {}, 'off_pad', 400),
    ({'tilt': 60.0}, {'tilt_limit': 180.0}, 'tipped', 400),
    ({'velocity': (2.0, -1.0)}, {'foot_friction': 0.0}, 'timeout', 400),
])
def test_other_ends_of_a_touchdown(
    how: dict[str, Any], settings: dict[str, Any], expected: str, steps: int,
) -> None:
    world = make(**settings)
    put(world, 0, **how)
    episodes, _, reward = ends(world, steps=steps)
    assert outcome(world, episodes) == expected
    assert reward == pytest.approx(-100.01)
    if expected == 'timeout':
        assert episodes.length[0] == 1 + 250


@pytest.mark.parametrize(('touchdown_height', 'dt'), [
    (0.0, 0.02), (0.05, 0.02), (0.05, 0.1), (HEIGHT, 0.02)])
def test_rockets_with_short_legs_can_land(touchdown_height: float, dt: float) -> None:
    """At 2 m/s, wherever the step ends that brings the feet to the ground or below."""
    world = make(16, touchdown_height=touchdown_height, dt=dt, level=1, spawn_angle=0.0)
    world.position[1] = touchdown_height + np.linspace(0.001, 2.0 * dt, 16)
    world.velocity[1] = -2.0 + world.settings.gravity * dt
    found = np.full(16, -1)
    for _ in range(round(6.0 / dt)):
        episodes = world.step(np.tile((-1.0, 0.0, 0.0), (16, 1)))[4]['episodes']
        new = found[episodes.row] < 0
        found[episodes.row[new]] = episodes.outcome[new]
        if (found >= 0).all():
            break
    assert [world.spec.outcomes[code] for code in found] == ['landed'] * 16


def test_a_rocket_on_its_side_has_tipped() -> None:
    """The hull is first to touch."""
    world = make(tilt_limit=180.0)
    put(world, 0, tilt=100.0)
    world.position[1, 0] = 7.0
    world.velocity[1, 0] = -1.0
    episodes, _, _ = ends(world, steps=40)
    assert outcome(world, episodes) == 'tipped'


def test_a_rocket_that_is_low_but_does_not_touch_flies_on() -> None:
    """Narrow legs that lean reach less far down than the height at which they stand."""
    world = make(tilt_limit=180.0, stance=0.5)
    put(world, 0, tilt=70.0)
    world.position[1, 0] = 4.0
    assert not world.step(np.array([[-1.0, 0.0, 0.0]]))[2].any()
    world.position[1, 0] = 2.0
    assert world.step(np.array([[-1.0, 0.0, 0.0]]))[2].all()


def test_a_rocket_that_leans_too_much_may_still_stand() -> None:
    """A value beyond its limit at first contact earns nothing, but costs nothing."""
    world = make()
    put(world, 0, tilt=15.0, above=0.001)
    episodes, last, reward = ends(world)
    assert outcome(world, episodes) == 'landed'
    assert np.rad2deg(episodes.tilt[0]) == pytest.approx(15.0, abs=1e-6)
    assert last.orientation[0, 2] == pytest.approx(0.0, abs=1e-3)
    assert reward == pytest.approx(
        -0.01 + 100 + (1 - episodes.touchdown_speed[0] / 3) * 100
        + (1 - episodes.distance[0] / 15) * 50)


def test_first_contact_of_an_upright_rocket_is_touchdown_in_rocket() -> None:
    """The same step, and the same speed and tilt."""
    planar, rocket = make(engine_cutoff=True), worlds.make('rocket', 1)
    assert isinstance(rocket, RocketWorld)
    put(planar, 0, above=3.0, velocity=(0.1, -1.0))
    for name in STATE:
        getattr(rocket, name)[:] = getattr(planar, name)
    sinking = np.array([[-0.05, 0.0, 0.0]])
    for _ in range(400):
        planar.step(sinking)
        _, _, ended, _, info = rocket.step(sinking)
        if ended[0]:
            break
    speed = info['episodes'].touchdown_speed
    assert ended[0] and speed[0] < 3.0
    assert planar._steps_down[0] == 0
    episodes, _, _ = ends(planar)
    assert np.array_equal(episodes.touchdown_speed, speed)
    assert np.array_equal(episodes.tilt, info['episodes'].tilt)
    assert episodes.length[0] > info['episodes'].length[0]


@pytest.mark.parametrize('cutoff', [True, False])
def test_the_contact_switch_cuts_the_engine(cutoff: bool) -> None:
    """Without it a rocket at full throttle takes off again, until its time is up."""
    world = make(engine_cutoff=cutoff)
    put(world, 0, velocity=(0.0, -1.0))
    episodes, last, _ = ends(world, (1.0, 0.0, 0.0))
    if cutoff:
        assert outcome(world, episodes) == 'landed'
        assert last.throttle[0] == 0.0
        assert episodes.fuel_used[0] == pytest.approx(470_880 / 282 / 9.81 * 0.02)
    else:
        assert outcome(world, episodes) == 'timeout'
        assert last.throttle[0] == 1.0
        assert last.position[0, 1] > 100.0


# Independence


def random_flights(world: RocketPlanarWorld, steps: int, rows: int) -> list[list[NDArray[Any]]]:
    """Throw rockets at the ground at random and return the results of the first rows."""
    rng = np.random.default_rng(5)
    results = []
    for _ in range(steps):
        action = rng.uniform(-1, 1, (70, 3)) * (0.5, 1.0, 0.02)
        seen, reward, ended, _, info = world.step(action[:world.spec.num_envs])
        chosen = info['final_rows'] < rows
        results.append([
            seen[:rows], reward[:rows], ended[:rows],
            *(getattr(info['episodes'], name)[chosen] for name in (
                'row', 'episode', 'episode_return', 'length', 'outcome', 'tilt', 'distance')),
            *(getattr(world.telemetry(np.arange(rows)), name) for name in (
                'contact', 'contact_force'))])
    return results


def low(num_envs: int) -> RocketPlanarWorld:
    """Return a world where rockets are low and slow, so that many touch down softly."""
    return make(
        num_envs, seed=6, spawn_height=9.0, spawn_speed=0.5, spawn_angle=20.0, spawn_spin=0.2,
        landed_speed=8.0)


def test_a_rocket_does_not_depend_on_how_many_others_there_are() -> None:
    alone, many = (random_flights(low(count), 700, 5) for count in (5, 70))
    ended = touched = 0
    for mine, theirs in zip(alone, many, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(mine, theirs, strict=True))
        ended += int(mine[2].sum())
        touched += int(mine[-2].any(1).sum())
    assert ended > 5
    assert touched > 200


def test_equal_seeds_give_equal_flights_and_others_do_not() -> None:
    one, two = (random_flights(low(20), 300, 20) for _ in range(2))
    for mine, theirs in zip(one, two, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(mine, theirs, strict=True))
    other = low(20)
    other.reset(seed=7)
    assert not np.array_equal(random_flights(other, 300, 20)[-1][0], one[-1][0])


def test_a_reset_during_touchdowns_equals_a_new_world() -> None:
    used, fresh = low(40), low(40)
    random_flights(used, 83, 1)
    assert (used._steps_down > 0).any()
    used.reset(seed=6)
    for mine, theirs in zip(
            random_flights(used, 300, 40), random_flights(fresh, 300, 40), strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(mine, theirs, strict=True))


# Pilots of `rocket`


def shipped(world: RocketPlanarWorld) -> Pilot:
    """Return the policy that ships, which has never seen this world."""
    folder = Path(ppo_agent_node.__file__).parent
    return PolicyPilot(folder / 'policies' / 'rocket.safetensors', world.spec)


@pytest.mark.slow
@pytest.mark.parametrize('make_pilot', [lambda world: ExpertPilot(world.spec), shipped])
def test_pilots_of_rocket_land_in_the_planar_world(
        make_pilot: Callable[[RocketPlanarWorld], Pilot]) -> None:
    world = make(200, level=7)
    result = evaluate(world, make_pilot(world), 200, seed=11, level=7)
    assert result.landed.all()
    assert result.episodes.episode_return.mean() > 285
    assert result.episodes.touchdown_speed.mean() < 0.3


# Headings


def turned(observation: NDArray[np.float32], heading: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return observations `(N, 15)` of the x-y plane in axes turned about the vertical."""
    cos, sin = heading
    seen = observation.astype(np.float64)
    along, across = seen[:, 0::3].copy(), seen[:, 2::3].copy()
    seen[:, 0::3] = cos[:, None] * along + sin[:, None] * across
    seen[:, 2::3] = cos[:, None] * across - sin[:, None] * along
    return seen


def test_a_heading_turns_observations_and_actions_only() -> None:
    """Commands across its plane are not flown."""
    straight = worlds.make('rocket_planar', 20, seed=2)
    other = worlds.make('rocket_planar', 20, seed=2)
    first = straight.observe()
    seen = other.reset(2, spawn_heading=180.0)
    heading = other._heading
    assert np.hypot(*heading) == pytest.approx(1.0)
    assert np.ptp(np.arctan2(heading[1], heading[0])) > np.pi
    assert seen == pytest.approx(turned(first, heading), abs=1e-6)
    rng = np.random.default_rng(1)
    episodes = 0
    for _ in range(300):
        throttle, torque, across = rng.uniform(-0.7, 0.7, (3, 20))
        cos, sin = other._heading
        observation, *_, info = straight.step(
            np.stack((throttle, np.zeros(20), torque), axis=1))
        action = np.stack(
            (throttle, sin * torque + cos * across, cos * torque - sin * across), axis=1)
        seen, *_, theirs = other.step(action)
        assert np.array_equal(info['final_rows'], theirs['final_rows'])
        episodes += len(info['final_rows'])
        assert other.position == pytest.approx(straight.position, abs=1e-6)
        assert seen == pytest.approx(turned(observation, other._heading), abs=1e-5)
    assert episodes > 10


def test_headings_are_drawn_for_each_episode_and_survive_a_snapshot() -> None:
    world = worlds.make('rocket_planar', 6, seed=2)
    world.reset(2, spawn_heading=90.0)
    before = world._heading.copy()
    assert (before[0] >= 0).all()
    for _ in range(200):
        info = world.step(np.tile((-1.0, 0.3, 0.9), (6, 1)))[4]
    assert not np.array_equal(world._heading, before)
    state, seen = world.snapshot(), world.observe()
    other = worlds.make('rocket_planar', 6, seed=3)
    assert np.array_equal(other.restore(state), seen)
    assert np.array_equal(other._heading, world._heading)
    assert len(info) == 3
    world.reset(2)
    assert (world.observe()[:, 2::3] == 0).all()


def test_the_expert_lands_at_any_heading() -> None:
    world = worlds.make('rocket_planar', 100)
    episodes = evaluate(world, ExpertPilot(world.spec), 200, 4, spawn_heading=180.0).episodes
    assert (episodes.outcome == 0).all()


# Cases that a review found without a test


def test_the_ground_extends_as_far_as_a_rocket_can_slide() -> None:
    """No rocket falls off its end; one that leaves the field is out of bounds."""
    world = worlds.make(
        'rocket_planar', 40, foot_friction=0.0, hull_friction=0.0, spawn_speed=50.0, level=1,
        spawn_height=12.0, landed_speed=500.0, touchdown_limit=20.0, rest_time=0.1)
    lowest, outcomes = 0.0, set()
    for _ in range(900):
        info = world.step(np.tile((-1.0, 0.0, 0.0), (40, 1)))[4]
        lowest = min(lowest, float(world.position[1].min()))
        if len(info['final_rows']):
            outcomes |= set(info['episodes'].outcome.tolist())
    assert lowest > -1.0
    assert 6 in outcomes


@pytest.mark.parametrize('stance', [70.0, 300.0])
def test_wide_legs_stand_on_the_same_ground_in_any_batch(stance: float) -> None:
    def distance(count: int) -> float:
        world = worlds.make(
            'rocket_planar', count, stance=stance, spawn_height=6.0, level=1, spawn_angle=0.0,
            spawn_speed=0.3, seed=3)
        for _ in range(400):
            info = world.step(np.tile((-0.2, 0.0, 0.0), (count, 1)))[4]
            rows = info['final_rows']
            if len(rows) and rows[0] == 0:
                return float(info['episodes'].distance[0])
        raise AssertionError('nobody came down')

    assert distance(1) == distance(2) == distance(40)


def test_a_start_with_a_foot_in_the_ground_is_refused() -> None:
    with pytest.raises(ValueError, match='where foot or hull could touch'):
        worlds.make('rocket_planar', level=4, spawn_height=5.3, tilt_limit=60.0)
    world = worlds.make('rocket_planar', seed=1)
    before = world.snapshot()
    with pytest.raises(ValueError, match='where foot or hull could touch'):
        world.reset(4, spawn_height=6.0)
    assert world.snapshot() == before
    with pytest.raises(ValueError, match='where foot or hull could touch'):
        worlds.make('rocket_planar', spawn_height=15.0, spawn_angle=170.0, tilt_limit=180.0)
    with pytest.raises(ValueError, match='rest_time'):
        worlds.make('rocket_planar', rest_time=6.0)
    with pytest.raises(ValueError, match=r'takes 1 steps of 0\.02 s, expected at most the 0'):
        worlds.make('rocket_planar', rest_time=0.0, touchdown_limit=0.01)
    with pytest.raises(ValueError, match=r'takes 2 steps of 0\.02 s, expected at most the 1'):
        worlds.make('rocket_planar', rest_time=0.03, touchdown_limit=0.03)
    worlds.make('rocket_planar', rest_time=0.0, touchdown_limit=0.02)


@pytest.mark.parametrize(('angle', 'tilt_limit', 'least'), [
    (35.0, 45.0, HEIGHT + STANCE * np.deg2rad(35.0)),
    (170.0, 45.0, HEIGHT + STANCE * np.deg2rad(170.0)),
    (170.0, 180.0, 37.578)])
def test_low_starts_keep_clear_of_the_ground(
    angle: float, tilt_limit: float, least: float,
) -> None:
    """The feet's limit is at the lowest starts, where sines equal angles; the nose's is higher."""
    given = {'spawn_angle': angle, 'tilt_limit': tilt_limit}
    rows = np.arange(20_000)
    for reach in (0.5, 2.9):
        message = f"'spawn_height': got .*than {least:.3f} m, .*, as spawn_reach is not 0$"
        with pytest.raises(ValueError, match=message):
            make(spawn_reach=reach, spawn_height=least - 0.001, **given)
        world = make(spawn_reach=reach, spawn_height=least + 0.001, **given)
        task = world.settings
        low = spawn.draw(1, rows, rows, spawn.spawn_range(task), task, in_plane=True)
        up = rotation.up_vector(low.attitude)
        assert (contact_model.heights(world._corners, low.position[1], -up[0], up[1]) > 0).all()


def test_a_reset_to_low_starts_in_the_ground_changes_nothing() -> None:
    world = make(spawn_height=8.6)
    before = world.snapshot()
    with pytest.raises(ValueError, match='as spawn_reach is not 0'):
        world.reset(spawn_reach=1.0)
    assert world.snapshot() == before


def test_contact_ends_with_the_episode() -> None:
    """A rocket that begins a new episode is not on the ground any more."""
    world = worlds.make('rocket_planar', 8, spawn_height=6.5, level=1, seed=2)
    ended = 0
    for _ in range(300):
        rows = world.step(np.tile((-0.2, 0.0, 0.0), (8, 1)))[4]['final_rows']
        ended += len(rows)
        assert not world.contact.present[rows].any()
        assert (world.contact.present == (world._steps_down >= 0)).all()
    assert ended > 8
