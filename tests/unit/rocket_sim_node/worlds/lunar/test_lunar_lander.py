# SPDX-License-Identifier: Apache-2.0
"""World `lunar_lander` by its own rules: rewards, ends, randomness, snapshots, telemetry."""
from __future__ import annotations

import gc
import threading
import time
from typing import Any

import numpy as np
import psutil
import pytest
from numpy.typing import NDArray
from support.invalid_data.forged_files import assert_value_refused
from support.invalid_data.forged_files import contents

from ppo_agent_node.pilots.lunar_heuristic import LunarHeuristic
from rocket_sim_node import worlds
from rocket_sim_node.worlds import random_streams
from rocket_sim_node.worlds.lunar import vehicle as vehicle
from rocket_sim_node.worlds.lunar.engines import Engines
from rocket_sim_node.worlds.lunar.engines import side_torque
from rocket_sim_node.worlds.lunar.vehicle import LunarSettings
from rocket_sim_node.worlds.lunar.world import LANDED
from rocket_sim_node.worlds.lunar.world import OUT_OF_BOUNDS
from rocket_sim_node.worlds.lunar.world import TIMEOUT
from rocket_sim_node.worlds.lunar.world import LunarLanderWorld

NOTHING, LEFT, MAIN, RIGHT = range(4)


def make(num_envs: int = 5, seed: int = 3, **settings: Any) -> LunarLanderWorld:
    world = worlds.make('lunar_lander', num_envs, seed, **settings)
    assert isinstance(world, LunarLanderWorld)
    return world


def fly(world: LunarLanderWorld, steps: int, seed: int) -> list[tuple[NDArray[Any], ...]]:
    """Fly the heuristic pilot, disturbed at random, through contacts and ends of episodes."""
    pilot, rng = LunarHeuristic(world.spec), np.random.default_rng(seed)
    observation, seen = world.observe(), []
    for _ in range(steps):
        action = pilot(observation)
        # Numbers for more landers than there are: the first ones get the same in any batch.
        disturbed = rng.random(512)[:len(action)] < 0.1
        other = rng.uniform(-1, 1, (512, 2))[:len(action)]
        if world.spec.continuous:
            action[disturbed] = other[disturbed]
        else:
            action[disturbed] = np.floor(2 * other[disturbed, 0] + 2)
        observation, reward, terminated, truncated, info = world.step(action)
        seen.append((
            observation.copy(), reward, terminated, truncated, info['final_observation']))
    return seen


def assert_equal(a: list[Any], b: list[Any], rows: int | None = None) -> None:
    for step, (one, other) in enumerate(zip(a, b, strict=True)):
        for x, y in zip(one[:4], other[:4], strict=True):
            assert np.array_equal(x[:rows], y[:rows]), f'step {step}'


def ended(seen: list[Any]) -> int:
    return sum(int((step[2] | step[3]).sum()) for step in seen)


def test_the_spaces_are_those_of_gymnasium() -> None:
    spec = make().spec
    assert (spec.observation_size, spec.continuous, spec.action_count) == (8, False, 4)
    assert spec.dt == 0.02
    spec = make(continuous=True).spec
    assert (spec.continuous, spec.action_size, spec.action_low) == (True, 2, (-1.0, -1.0))


@pytest.mark.parametrize('continuous', [False, True])
def test_equal_seeds_give_equal_flights_and_another_does_not(continuous: bool) -> None:
    first = fly(make(9, continuous=continuous), 500, 1)
    assert ended(first) > 5
    assert_equal(first, fly(make(9, continuous=continuous), 500, 1))
    other = fly(make(9, seed=4, continuous=continuous), 3, 1)
    assert not np.array_equal(first[0][0], other[0][0])


@pytest.mark.parametrize('num_envs, step_threads', [(1, 2), (100, 3), (70, 64)])
def test_any_number_of_threads_flies_the_same_bits(num_envs: int, step_threads: int) -> None:
    """Over one Space and several, through contacts, ends of episodes and a snapshot."""
    one, more = make(num_envs), make(num_envs, step_threads=step_threads)
    first = fly(one, 400, 1)
    assert num_envs == 1 or ended(first) >= 1
    assert_equal(first, fly(more, 400, 1))
    more.restore(one.snapshot())
    assert_equal(fly(one, 100, 2), fly(more, 100, 2))


def test_threads_end_with_their_world() -> None:
    def stepping() -> list[threading.Thread]:
        return [one for one in threading.enumerate() if one.name.startswith('lanes')]

    def gone() -> bool:
        gc.collect()
        deadline = time.monotonic() + 20.0
        while stepping() and time.monotonic() < deadline:
            time.sleep(0.01)
        return not stepping()

    assert gone(), 'of earlier tests'
    world = make(100, step_threads=3)
    fly(world, 2, 1)
    assert 1 <= len(stepping()) <= 2
    del world
    assert gone()


@pytest.mark.parametrize('world, got, expected', [
    ('rocket', 2, "1, as world 'rocket' is stepped by one thread"),
    ('rocket_planar', 2, "1, as world 'rocket_planar' is stepped by one thread"),
    ('lunar_lander', 0, '1 to 256'),
    ('lunar_lander', 257, '1 to 256'),
    ('lunar_lander', 1.5, 'a whole number'),
    ('lunar_lander', True, 'a number'),
])
def test_a_bad_number_of_threads_is_refused(world: str, got: Any, expected: str) -> None:
    with pytest.raises((TypeError, ValueError)) as error:
        worlds.make(world, 2, step_threads=got)
    assert str(error.value) == f'step_threads: got {got!r}, expected {expected}'


def test_a_number_of_threads_may_be_a_whole_float() -> None:
    assert worlds.make('lunar_lander', 2, step_threads=2.0).spec.num_envs == 2  # type: ignore[arg-type]


@pytest.mark.parametrize('num_envs', [1, 7, 40, 100])
def test_a_lander_does_not_depend_on_how_many_fly_beside_it(num_envs: int) -> None:
    """Bit for bit, over Spaces full and not, while neighbours crash, rest and are reset."""
    many = fly(make(70), 600, 2)
    assert_equal(fly(make(num_envs), 600, 2), many, min(num_envs, 70))


def test_a_reset_world_equals_a_new_one() -> None:
    """No state of Chipmunk leaks into the next episode."""
    used = make(40)
    fly(used, 450, 5)
    used.snapshot()  # only the next step has more iterations
    fly(used, 1, 5)
    used.reset(11)
    assert_equal(fly(used, 500, 6), fly(make(40, seed=11), 500, 6))


@pytest.mark.parametrize('num_envs', [1, 40])
def test_a_restored_world_flies_on_bit_for_bit(num_envs: int) -> None:
    """While landers fly, touch, rest or have just begun; in the world itself and in another."""
    world = make(num_envs)
    fly(world, 333, 7)
    state, seen = world.snapshot(), world.observe()
    onwards = fly(world, 500, 8)
    other = make(num_envs, seed=12)
    fly(other, 100, 9)
    assert np.array_equal(other.restore(state), seen)
    assert other.snapshot() == state
    assert_equal(fly(other, 500, 8), onwards)
    world.restore(state)
    assert_equal(fly(world, 500, 8), onwards)


def test_snapshots_do_not_keep_a_lander_from_resting() -> None:
    """A lander rests for 25 steps before it counts as landed; a snapshot must not move it."""
    def lengths(every: int) -> NDArray[np.int64]:
        world = make(16)
        pilot, observation = LunarHeuristic(world.spec), world.observe()
        found = np.zeros(16, np.int64)
        for step in range(1, 501):
            observation, _, _, _, info = world.step(pilot(observation))
            episodes = info['episodes']
            first = (episodes.episode == 0) & (episodes.outcome == LANDED)
            found[episodes.row[first]] = episodes.length[first]
            if step % every == 0:
                world.snapshot()
        return found

    undisturbed, disturbed = lengths(1000), lengths(20)
    landed = undisturbed > 0
    assert landed.sum() > 10
    assert (np.abs(disturbed - undisturbed)[landed] < 50).all()


def test_a_snapshot_just_after_a_reset_is_exact() -> None:
    world = make(3)
    state = world.snapshot()
    onwards = fly(world, 200, 1)
    other = make(3, seed=9)
    other.restore(state)
    assert_equal(fly(other, 200, 1), onwards)


@pytest.mark.parametrize(('name', 'value', 'message'), [
    ('lanes_pose', 1e9, 'pose has a value beyond'), ('shaping', 1e300, 'beyond'),
    ('age', -1, 'age has a value below 0'),
    ('settings', 5.0, 'of a world with dt 5, expected 0.02'), ('still', np.nan, 'not finite'),
])
def test_a_forged_snapshot_changes_nothing(name: str, value: float, message: str) -> None:
    assert_value_refused(make(), name, value, message)


def test_snapshots_of_other_worlds_are_refused() -> None:
    with pytest.raises(ValueError, match="of world 'rocket', expected 'lunar_lander'"):
        make().restore(worlds.make('rocket', 5).snapshot())
    with pytest.raises(ValueError, match='shape'):
        make().restore(make(6).snapshot())


def test_the_return_is_the_rise_of_the_potential_less_fuel() -> None:
    """Shaping telescopes: -100 (distance + speed + tilt) + 10 a leg, -0.3 main, -0.03 side."""
    world = make(1, seed=1)

    def potential(observation: NDArray[np.float32]) -> float:
        x, y, vx, vy, angle, _, leg_1, leg_2 = observation[0].astype(float)
        return float(
            -100 * (np.hypot(x, y) + np.hypot(vx, vy) + abs(angle)) + 10 * (leg_1 + leg_2))

    before = potential(world.observe())
    total = 0.0
    actions = [MAIN] * 5 + [LEFT] * 3 + [RIGHT] * 2 + [NOTHING] * 4
    for action in actions:
        observation, reward, terminated, _, _ = world.step(np.array([action]))
        assert not terminated.any()
        total += float(reward[0])
    expected = potential(observation) - before - 5 * 0.3 - 5 * 0.03
    assert total == pytest.approx(expected, abs=1e-3)


def test_crash_exit_and_rest_have_the_rewards_of_gymnasium() -> None:
    world = make(30)
    pilot = LunarHeuristic(world.spec)
    observation = world.observe()
    ends: dict[int, set[float]] = {}
    for step in range(700):
        action = pilot(observation)
        action[:10] = NOTHING
        action[10:20] = MAIN if step < 300 else LEFT
        observation, reward, terminated, truncated, info = world.step(action)
        episodes = info['episodes']
        assert (terminated | truncated).sum() == len(episodes)
        for row, outcome in zip(episodes.row, episodes.outcome, strict=True):
            ends.setdefault(int(outcome), set()).add(float(reward[row]))
    assert ends[LANDED] == {100.0}
    assert ends[OUT_OF_BOUNDS] == {-100.0}
    assert ends[1] == {-100.0}  # crashed


def test_the_time_limit_truncates_after_a_thousand_steps() -> None:
    """Held up by its main engine a lander neither lands nor crashes."""
    world = make(1, seed=2)
    observation = world.observe()
    pilot = LunarHeuristic(world.spec)
    for step in range(1, 1001):
        height = observation[0, 1]
        # The heuristic, made to believe that it is always too low.
        observation[0, 1] = height - 1.0
        observation, reward, terminated, truncated, info = world.step(pilot(observation))
        assert not terminated.any()
        assert bool(truncated[0]) == (step == 1000)
    assert info['episodes'].outcome.tolist() == [TIMEOUT]
    assert abs(reward[0]) < 50


def test_resting_takes_half_a_second_below_box2ds_limits() -> None:
    world = make(20, continuous=True)
    pilot = LunarHeuristic(world.spec)
    observation = world.observe()
    still = np.zeros(20)
    landed = 0
    for _ in range(400):
        observation, _, _, _, info = world.step(pilot(observation))
        episodes = info['episodes']
        for row in episodes.row[episodes.outcome == LANDED]:
            landed += 1
            # 24 steps before this one, and this one: 25 x 0.02 s.
            assert still[row] == 24
        velocity = world._lanes.velocity
        slow = (np.hypot(velocity[..., 0], velocity[..., 1]) <= 0.01) & (
            np.abs(velocity[..., 2]) <= np.deg2rad(2))
        still = np.where(slow.all(1), still + 1, 0)
        still[episodes.row] = 0
    assert landed > 10


@pytest.mark.parametrize(('settings', 'message'), [
    ({'dt': 0.05, 'rest_time': 0.11, 'time_limit': 0.12},
     r"^setting 'rest_time': got 0\.11, which takes 3 steps of 0\.05 s, "
     r'expected at most the 2 of time_limit, 0\.12 s$'),
    ({'rest_time': 20.01}, r'which takes 1001 steps .* the 1000 of time_limit, 20\.0 s$')])
def test_a_rest_of_more_steps_than_an_episode_is_refused(
    settings: dict[str, float], message: str,
) -> None:
    """In whole steps, the rest is rounded up and the limit down."""
    with pytest.raises(ValueError, match=message):
        make(**settings)


@pytest.mark.parametrize(('dt', 'rest_time', 'time_limit', 'steps'), [
    (0.05, 0.1, 0.12, 2), (0.05, 0.03, 0.02, 1), (0.02, 0.5, 0.5, 25), (0.02, 0.0, 0.02, 1)])
def test_a_rest_of_as_many_steps_as_an_episode_is_a_landing(
    dt: float, rest_time: float, time_limit: float, steps: int, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each has at least one, and the lander rests from the start."""
    world = make(
        1, dt=dt, rest_time=rest_time, time_limit=time_limit, spawn_reach=0.01, rest_speed=10.0,
        rest_spin=360.0)
    advance = world._advance

    def rig(command: NDArray[Any]) -> None:
        advance(command)
        world._touching[:] = (False, True, False)

    monkeypatch.setattr(world, '_advance', rig)
    ended = [world.step(np.zeros(1, np.int64))[4]['episodes'] for _ in range(steps)]
    assert [len(episodes) for episodes in ended] == [0] * (steps - 1) + [1]
    assert ended[-1].outcome.tolist() == [LANDED]


def test_position_and_velocity_of_the_state_are_of_the_same_point() -> None:
    """As in nav_msgs/Odometry, whose twist is that of the frame that its pose names."""
    world = worlds.make('lunar_lander', 4, 3)
    rows = np.arange(4)
    turning = np.full(4, LEFT)
    for _ in range(60):
        world.step(turning)
    before = world.telemetry(rows)
    world.step(turning)
    after = world.telemetry(rows)
    assert (np.abs(after.angular_velocity[:, 2]) > 1.0).all()
    # Along x, where gravity does not change the velocity within the step.
    moved = (after.position - before.position)[:, 0] / world.spec.dt
    mean = (before.linear_velocity + after.linear_velocity)[:, 0] / 2
    assert moved == pytest.approx(mean, abs=0.03)


def test_legs_bear_the_lander_at_their_inner_stop() -> None:
    """At rest on the pad it stands on both legs, upright; feet on the ground within 1 cm."""
    world = make(20, continuous=True)
    pilot = LunarHeuristic(world.spec)
    observation = world.observe()
    found = 0
    for _ in range(400):
        observation = world.step(pilot(observation))[0]
        finished = world.finished
        level = (finished.terrain[:, 4:7] == finished.terrain[:, 5:6]).all(1)
        centre = np.abs(finished.position[:, 0]) < 1.5
        for k in np.flatnonzero((finished.outcome == LANDED) & level & centre):
            found += 1
            assert finished.contact[k].all()
            assert np.abs(finished.leg_angle[k]).max() < 0.02
            assert finished.position[k, 1] == pytest.approx(_standing_height(), abs=0.02)
            # The ground bears its weight.
            assert finished.contact_force[k, 1] == pytest.approx(
                10.0 * vehicle.TOTAL_MASS, rel=0.05)
    assert found > 5


def _standing_height() -> float:
    """Return the hull's origin above ground with both legs at the inner stop, m."""
    _, y = vehicle.leg_offset(1.0, vehicle.LEG_INNER)
    tip = np.sin(vehicle.LEG_INNER) * vehicle.LEG_HALF_WIDTH + (
        np.cos(vehicle.LEG_INNER) * vehicle.LEG_HALF_LENGTH)
    return tip - y + 0.02


def test_side_engines_push_and_turn_the_right_way() -> None:
    """Action 1 fires the left engine: it turns counter-clockwise and drifts to the left."""
    spins, drifts = {}, {}
    for action in (NOTHING, LEFT, RIGHT):
        world = make(200, seed=5)
        before = world.observe()
        for _ in range(5):
            observation = world.step(np.full(200, action))[0]
        spins[action] = float((observation - before)[:, 5].mean())
        drifts[action] = float((observation - before)[:, 2].mean())
        thrust = world.telemetry(slice(None)).lateral_thrust
        assert np.sign(thrust).tolist() == [{LEFT: -1, RIGHT: 1}.get(action, 0)] * 200
    assert spins[LEFT] > 0.01 + spins[NOTHING]
    assert spins[RIGHT] < -0.01 + spins[NOTHING]
    assert drifts[LEFT] < drifts[NOTHING] < drifts[RIGHT]


def test_the_scatter_of_the_engines_has_numbers_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Not those again that the terrain and the first push were made of."""
    taken: list[tuple[int, int]] = []
    numbers = random_streams.numbers

    def note(key: np.ndarray, draws: int, first: Any = 0) -> np.ndarray:
        taken.append((int(np.min(first)), draws))
        return numbers(key, draws, first)

    monkeypatch.setattr(random_streams, 'numbers', note)
    world = make(1)
    for _ in range(3):
        world.step(np.zeros(1, np.int64))
    places = [place for first, draws in taken[-4:] for place in range(first, first + draws)]
    assert sorted(places) == list(range(16 + 3 * 2))


def test_main_engine_delivers_its_impulse() -> None:
    """13 x 4/30 N s a step on 4.96 kg, the scatter averaged out."""
    world = make(400, seed=5)
    before = world._lanes.velocity[:, 0, 1].mean()
    steps = 20
    for _ in range(steps):
        world.step(np.full(400, MAIN))
    gained = world._lanes.velocity[:, 0, 1].mean() - before
    tilt = np.cos(world._lanes.pose[:, 0, 2]).mean()
    expected = steps * (13 * 4 / 30 / vehicle.TOTAL_MASS - 10 * 0.02)
    assert gained == pytest.approx(expected, rel=0.03)
    assert tilt > 0.95


def test_continuous_commands_have_gymnasiums_dead_zones() -> None:
    world = make(6, continuous=True)
    command = np.array(
        [[-0.5, 0.4], [0.0, 0.5], [1e-6, 0.51], [0.5, -0.51], [1.0, 1.0], [3.0, -2.0]])
    world.step(command)
    assert world._main.tolist() == pytest.approx([0, 0, 0.5, 0.75, 1, 1], abs=1e-5)
    assert world._side.tolist() == pytest.approx([0, 0, 0.51, -0.51, 1, -1])


def test_wind_follows_its_pattern_until_a_leg_touches() -> None:
    """tanh(sin 2kx + sin pi kx), k = 0.01, x one further a step; the pattern starts at random."""
    calm, windy = make(50, seed=6), make(50, seed=6, enable_wind=True)
    place = windy._wind.copy()
    assert len(np.unique(place)) > 50
    assert (np.abs(place) <= 9999).all()
    for _ in range(3):
        calm.step(np.zeros(50, np.int64))
        windy.step(np.zeros(50, np.int64))
    drift = windy._lanes.velocity[:, 0, 0] - calm._lanes.velocity[:, 0, 0]
    strength = sum(
        np.tanh(np.sin(0.02 * (place[0] + k)) + np.sin(np.pi * 0.01 * (place[0] + k)))
        for k in range(3))
    assert drift == pytest.approx(15.0 * 0.02 * strength / vehicle.TOTAL_MASS, abs=6e-3)
    windy._touching[:25, 1] = True
    still = windy._wind.copy()
    windy._blow(np.zeros((50, 3)))
    assert np.array_equal(windy._wind[:, :25], still[:, :25])
    assert np.array_equal(windy._wind[:, 25:], still[:, 25:] + 1)


def test_few_landers_in_the_wind_fly_as_one_of_many() -> None:
    """Their formulas are computed lander by lander (see `engines.FEW`), with the same bits."""
    few, many = (make(n, seed=4, continuous=True, enable_wind=True) for n in (3, 30))
    throttles = np.random.default_rng(1).uniform(-1.2, 1.2, (300, 30, 2))
    for action in throttles:
        ours, theirs = few.step(action[:3]), many.step(action)
        for one, other in zip(ours[:4], theirs[:4], strict=True):
            assert one.tobytes() == other[:3].tobytes()


def test_wind_pushes_the_centre_of_the_hull() -> None:
    """It is 0.3 mm above the centre of gravity of hull and legs, 12.5 mm with legs drawn in."""
    calm, windy = make(20, seed=6), make(20, seed=6, enable_wind=True, turbulence_power=0.0)
    lanes = windy._lanes
    height = lanes.pose[:, 0, 1] + vehicle.HULL_CENTRE - vehicle.BODY_CENTRE
    centre = (lanes._mass * lanes.pose[:, :, 1]).sum(1) / vehicle.TOTAL_MASS
    arm = lanes.pose[:, :, :2] - np.stack((lanes.pose[:, 0, 0], centre), axis=1)[:, None]
    moment = (lanes._moment + lanes._mass * (arm**2).sum(2)).sum(1)

    def gained(steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Return what the wind added so far: impulse, N s, and angular momentum, N m s."""
        for _ in range(steps):
            calm.step(np.zeros(20, np.int64))
            windy.step(np.zeros(20, np.int64))
        motion = windy._lanes.velocity[:, 0] - calm._lanes.velocity[:, 0]
        return motion[:, 0] * vehicle.TOTAL_MASS, motion[:, 2] * moment

    push, turn = gained(1)
    assert turn == pytest.approx(-push * (height - centre), abs=1e-5)
    push, turn = gained(39)
    steady = np.abs(push) > 8.0
    assert steady.sum() > 3
    lever = -turn[steady] / push[steady]
    assert (lever > 0.0).all()
    assert (lever < 0.0125).all()


def test_terrain_is_smoothed_around_a_level_pad() -> None:
    world = make(300)
    terrain = world.terrain
    assert terrain[:, 4:7] == pytest.approx(0.99 * vehicle.PAD_HEIGHT)
    assert terrain.min() >= 0
    assert terrain.max() <= 0.99 * vehicle.HALF_HEIGHT
    assert terrain[:, 0].std() > 0.5
    # pymunk's ground is where telemetry says that it is.
    shapes, origin = world._lanes.ground(7)
    for k in range(10):
        assert tuple(shapes[k].a) == pytest.approx((origin - 10 + 2 * k, terrain[7, k]))
        assert tuple(shapes[k].b) == pytest.approx((origin - 8 + 2 * k, terrain[7, k + 1]))


def test_bad_actions_and_resets_are_refused() -> None:
    world = make()
    for action in (np.full(5, 4), np.full(5, -1), np.zeros(4, np.int64), np.zeros(5)):
        with pytest.raises(ValueError, match='action'):
            world.step(action)
    with pytest.raises(ValueError, match="unknown setting 'level', expected spawn_reach"):
        world.reset(level=7)
    with pytest.raises(ValueError, match='seed: got -1'):
        world.reset(-1)
    with pytest.raises(ValueError, match='action'):
        make(continuous=True).step(np.full((5, 2), np.nan))
    with pytest.raises(ValueError, match='gravity'):
        make(gravity=13.0)


def test_reset_without_a_seed_begins_the_next_episodes() -> None:
    """They are the same as those after a natural end."""
    world = make()
    world.reset()
    terrain = world.terrain.copy()
    other = make()
    while (other.episode == 0).any():
        rows = other.step(np.zeros(5, np.int64))[4]['final_rows']
        for row in rows[other.episode[rows] == 1]:
            assert np.array_equal(other.terrain[row], terrain[row])


def test_a_hundred_landers_leave_no_parts_behind() -> None:
    """Resets reuse bodies, shapes and joints."""
    world = make(40)

    def parts() -> list[int]:
        return [
            count for block in world._lanes._blocks for count in (
                len(block.space.bodies), len(block.space.shapes), len(block.space.constraints))]

    before = parts()
    rng = np.random.default_rng(0)
    for _ in range(1000):
        world.step(rng.integers(0, 4, 40))
    assert world.episode.sum() > 300
    assert parts() == before


@pytest.mark.slow
def test_memory_stays_flat_over_many_resets() -> None:
    """Resets in mid-air only: cells of the spatial hash far from there are swept all the same."""
    world = make(64)
    process = psutil.Process()

    def begin_anew(times: int) -> int:
        for _ in range(times):
            world._begin(world.rows)
            for _ in range(3):
                world.step(np.zeros(64, np.int64))
        return process.memory_info().rss

    before = begin_anew(200)
    # 0.5 kB a reset would be 13 MB.
    assert begin_anew(400) - before < 3e6


# Cases that a review found without a test


def test_wind_continues_after_a_restore() -> None:
    world = make(10, enable_wind=True)
    fly(world, 60, 1)
    state = world.snapshot()
    onwards = fly(world, 60, 2)
    other = make(10, seed=8, enable_wind=True)
    other.restore(state)
    assert_equal(fly(other, 60, 2), onwards)


def test_contact_forces_are_exact_after_a_restore() -> None:
    """They do not depend on the order of Chipmunk's contacts."""
    world = make(40)
    fly(world, 300, 7)
    other = make(40, seed=2)
    other.restore(world.snapshot())
    rows = np.arange(40)
    for action in np.random.default_rng(3).integers(0, 4, (200, 40)):
        world.step(action)
        other.step(action)
        assert np.array_equal(
            world.telemetry(rows).contact_force, other.telemetry(rows).contact_force)


def test_terrain_of_a_snapshot_is_that_of_its_episodes() -> None:
    """It is drawn again, so no snapshot can bring ground that is not there."""
    world = make(4)
    fly(world, 150, 1)
    other = make(4, seed=9)
    other.restore(world.snapshot())
    assert np.array_equal(other.terrain, world.terrain)
    assert 'terrain' not in contents(world.snapshot())


@pytest.mark.parametrize(('rest', 'struck', 'reward', 'outcome'), [
    (True, True, 100.0, LANDED), (False, True, -100.0, 1), (True, False, 100.0, LANDED),
])
def test_a_lander_at_rest_has_landed_also_on_its_hull(
    rest: bool, struck: bool, reward: float, outcome: int, monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = make(1)
    advance = world._advance

    def rig(command: NDArray[Any]) -> None:
        advance(command)
        world._still[:] = 1.0 if rest else 0.0
        world._touching[:] = (struck, True, False)

    monkeypatch.setattr(world, '_advance', rig)
    _, paid, _, _, info = world.step(np.zeros(1, np.int64))
    assert paid.tolist() == [reward]
    assert info['episodes'].outcome.tolist() == [outcome]


def test_no_rest_in_the_air() -> None:
    """Without gravity a lander that is not pushed stays where it is."""
    world = make(64, gravity=0.0, spawn_reach=0.05)
    for _ in range(100):
        standing = world._touching.any(1)
        episodes = world.step(np.zeros(64, np.int64))[4]['episodes']
        assert standing[episodes.row[episodes.outcome == LANDED]].all()
    assert ((world._still > 1.0) & ~world._touching.any(1)).any()


def test_no_rest_without_standing_still() -> None:
    world = make(4, rest_time=0.0)
    assert not world.step(np.zeros(4, np.int64))[2].any()
    with pytest.raises(ValueError, match="'rest_time': got 30"):
        make(rest_time=30.0)


def test_telemetry_distinguishes_left_and_right() -> None:
    """The left engine pushes to the left, as in Gymnasium; the left leg is at negative x."""
    world = make(1)
    world.step(np.array([LEFT]))
    telemetry = world.telemetry(np.array([0]))
    assert telemetry.lateral_thrust[0] == pytest.approx(-0.6 / 0.02 * 12 / 30)
    world._touching[:] = (False, True, False)
    telemetry = world.telemetry(np.array([0]))
    assert telemetry.contact.tolist() == [[True, False]]
    assert world.observe()[0, 6:].tolist() == [0.0, 1.0]
    left, right = world._lanes.pose[0, 1:, 0]
    assert left < right


def test_the_torque_of_the_state_is_that_of_the_side_engines() -> None:
    """About the hull's origin, where the wrench of the engines acts, at any angle of the hull."""
    engines = Engines(LunarSettings())
    angle = np.linspace(-3.0, 3.0, 21)
    sin, cos = np.sin(angle), np.cos(angle)
    side = np.where(angle > 1.0, 1.0, -1.0)
    force = np.zeros((21, 3))
    engines.push(sin, cos, np.zeros(21), side, np.zeros((2, 21)), force)
    centre = vehicle.BODY_CENTRE * np.stack((-sin, cos))
    expected = force[:, 2] + centre[0] * force[:, 1] - centre[1] * force[:, 0]
    lateral = side * engines.max_lateral_thrust
    np.testing.assert_allclose(force[:, :2], np.stack((lateral * cos, lateral * sin), axis=1))
    assert side_torque(lateral, sin, cos) == pytest.approx(expected)

    world = make(1)
    torque = {}
    for action in (NOTHING, LEFT, MAIN, RIGHT):
        world.step(np.array([action]))
        torque[action] = world.telemetry(slice(None)).torque[0]
        assert torque[action][:2].tolist() == [0.0, 0.0]
    assert torque[NOTHING][2] == torque[MAIN][2] == 0.0
    assert torque[LEFT][2] == pytest.approx(0.6 / 0.02 * 12 / 30 * 14 / 30, rel=0.05)
    assert torque[RIGHT][2] == pytest.approx(-torque[LEFT][2], rel=0.05)


def test_the_state_has_the_acceleration_by_the_wind() -> None:
    """It acts until a leg touches, and not before the first step."""
    world = make(50, seed=6, enable_wind=True)
    assert not world.telemetry(slice(None)).disturbance.any()
    place = 0.01 * world._wind[0]
    world.step(np.zeros(50, np.int64))
    wind = world.telemetry(slice(None)).disturbance
    strength = np.tanh(np.sin(2 * place) + np.sin(np.pi * place))
    assert wind[:, 0] == pytest.approx(15.0 * strength / vehicle.TOTAL_MASS)
    assert not wind[:, 1:].any()
    world._touching[:25, 1] = True
    world.step(np.zeros(50, np.int64))
    wind = world.telemetry(slice(None)).disturbance
    assert not wind[:25].any()
    assert wind[25:, 0].all()
    world.reset(seed=7)
    assert not world.telemetry(slice(None)).disturbance.any()
    calm = make(3)
    calm.step(np.zeros(3, np.int64))
    assert not calm.telemetry(slice(None)).disturbance.any()


def test_tilt_is_that_of_an_upright_lander_however_often_it_turned() -> None:
    world = make(5)
    tilts: list[float] = []
    for _ in range(600):
        info = world.step(np.full(5, LEFT))[4]
        if len(info['final_rows']):
            tilts += info['episodes'].tilt.tolist()
    assert tilts
    assert 0 <= min(tilts) <= max(tilts) <= np.pi
