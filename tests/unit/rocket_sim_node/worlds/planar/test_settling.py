# SPDX-License-Identifier: Apache-2.0
"""Settling after touchdowns in the 3-D world: verdicts, planes, and the way back to 3-D."""
from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ppo_agent_node.pilots.expert.expert import ExpertPilot
from rocket_sim_node import worlds
from rocket_sim_node.worlds.planar.landing_plane import LandingPlane
from rocket_sim_node.worlds.planar.settling import Settlement
from rocket_sim_node.worlds.planar.settling import settle

F64 = NDArray[np.float64]

G = 9.81
STANCE, HEIGHT = 6.7, 5.2
SETTINGS = worlds.make('rocket').spec.settings


def attitude(lean: float = 0.0, towards: float = 0.0, yaw: float = 0.0) -> F64:
    """Return a quaternion: yaw, then a lean towards a direction (deg from x to z)."""
    about = np.deg2rad(lean) * np.array(
        [np.sin(np.deg2rad(towards)), 0.0, -np.cos(np.deg2rad(towards))])
    turned: F64 = (
        Rotation.from_rotvec(about) * Rotation.from_euler('y', yaw, degrees=True)).as_quat()
    return turned


def touch_down(
    velocity: tuple[float, float, float] = (0.0, -0.5, 0.0), orientation: F64 | None = None,
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0), motion: bool = False, **settings: Any,
) -> Settlement:
    """Settle one rocket at (3, 5.1, 4)."""
    return settle(
        np.array([[3.0, 5.1, 4.0]]),
        (attitude() if orientation is None else orientation)[None],
        np.array([velocity]), np.array([spin]), np.array([22_500.0]),
        {**SETTINGS, **settings}, motion)


# Verdicts


def test_a_gentle_landing_stands() -> None:
    end = touch_down()
    assert end.names() == ['stands']
    assert end.standing.tolist() == [True]
    assert end.position[0] == pytest.approx((3.0, HEIGHT, 4.0), abs=0.0015)
    assert end.tilt[0] < 1e-3
    assert 0.0 < end.time[0] < 0.3
    assert json.dumps(end.names())


def test_a_fast_drift_slides_as_far_as_friction_lets_it() -> None:
    """v^2 / (2 mu g), along the velocity."""
    end = touch_down((1.8, 0.0, 2.4), dt=0.002)
    assert end.names() == ['slides']
    way = 3.0**2 / (2 * 0.6 * G)
    assert end.moved[0] == pytest.approx(way, rel=0.02)
    assert end.position[0] == pytest.approx((3.0 + 0.6 * way, HEIGHT, 4.0 + 0.8 * way), abs=0.02)
    assert end.time[0] == pytest.approx(3.0 / 0.6 / G, rel=0.2)


def test_elastic_feet_bounce() -> None:
    """To e^2 v^2 / (2 g)."""
    end = touch_down((0.0, -3.0, 0.0), foot_restitution=0.5, dt=0.002)
    assert end.names() == ['bounces']
    assert end.standing.tolist() == [True]
    assert end.rebound[0] == pytest.approx(0.25 * 3.0**2 / (2 * G), abs=0.01)


def test_feet_that_are_caught_tip_a_fast_rocket_over() -> None:
    """Beyond the speed at which it trips, see the tests of contact, and not below."""
    reach = np.hypot(STANCE, HEIGHT)
    mass = 22_500.0
    critical = np.sqrt(2 * G * (reach - HEIGHT) * (5e5 + mass * reach**2) / (mass * HEIGHT**2))
    for share, expected in ((0.95, True), (1.05, False)):
        end = touch_down(
            (share * critical, 0.0, 0.0), dt=0.005, foot_friction=10.0, foot_restitution=0.0)
        assert end.standing.tolist() == [expected]
        assert (end.names() == ['tips_over']) is not expected


@pytest.mark.parametrize('towards', [0.0, 77.0, 200.0])
def test_a_lean_beyond_one_foot_tips_over_to_that_side(towards: float) -> None:
    limit = np.rad2deg(np.arctan(STANCE / HEIGHT))
    still = (0.0, 0.0, 0.0)
    over = touch_down(still, attitude(limit + 1.0, towards), foot_friction=10.0)
    assert over.names() == ['tips_over']
    direction = np.deg2rad(towards)
    assert over.plane[0] == pytest.approx((np.cos(direction), np.sin(direction)), abs=1e-9)
    fell = over.position[0] - (3.0, 0.0, 4.0)
    assert fell[0] * np.cos(direction) + fell[2] * np.sin(direction) > 1.0
    assert over.tilt[0] > 80
    back = touch_down(
        still, attitude(limit - 1.0, towards), foot_friction=10.0, touchdown_limit=15.0)
    assert back.standing.tolist() == [True]


def test_a_rocket_that_is_not_at_rest_in_time_does_not_stand() -> None:
    end = touch_down((3.0, 0.0, 0.0), foot_friction=0.0)
    assert end.names() == ['tips_over']
    assert end.time[0] == 5.0


# Planes


def test_the_plane_is_that_of_the_velocity_then_of_the_lean_then_x() -> None:
    velocity = np.array([
        (0.3, -1.0, 0.4), (0.03, -1.0, 0.04), (0.03, -1.0, 0.04), (0.0, 0.0, 0.0)])
    orientation = np.stack([
        attitude(3.0, 10.0), attitude(3.0, 90.0), attitude(0.05, 90.0), attitude(0.0, 0.0, 50.0)])
    plane = LandingPlane(np.zeros((4, 3)), orientation, velocity)
    assert np.allclose(
        plane.direction.T, [(0.6, 0.8), (0.0, 1.0), (1.0, 0.0), (1.0, 0.0)], atol=1e-9)
    # Leaning along +x is a turn from y to x, against the sense of angles.
    assert np.rad2deg(plane.lean[1]) == pytest.approx(-3.0)
    along = np.rad2deg(np.arctan(np.tan(np.deg2rad(3)) * np.cos(np.arctan2(0.8, 0.6)
                                                                - np.deg2rad(10))))
    assert np.rad2deg(plane.lean[0]) == pytest.approx(-along)


def test_the_result_does_not_depend_on_the_plane() -> None:
    """A landing turned about the vertical has the same end, turned."""
    rng = np.random.default_rng(0)
    count = 60
    position = rng.uniform(-5, 5, (count, 3))
    orientation = Rotation.from_euler(
        'yzx', rng.uniform(-12, 12, (count, 3)) * (15, 1, 1), degrees=True)
    velocity = rng.uniform(-2, 2, (count, 3)) * (1, 0.5, 1)
    velocity[:, 1] -= 1.0
    spin = rng.uniform(-0.2, 0.2, (count, 3))
    turn = Rotation.from_euler('y', rng.uniform(-180, 180, (count, 1)), degrees=True)
    mass = rng.uniform(22_000, 24_000, count)
    one = settle(position, orientation.as_quat(), velocity, spin, mass, SETTINGS)
    two = settle(
        turn.apply(position), (turn * orientation).as_quat(), turn.apply(velocity),
        turn.apply(spin), mass, SETTINGS)
    assert np.array_equal(one.verdict, two.verdict)
    assert turn.apply(one.position) == pytest.approx(two.position, abs=1e-6)
    assert one.time == pytest.approx(two.time)
    assert len(set(one.names())) > 1


def test_the_vehicle_is_lifted_to_first_contact() -> None:
    end = touch_down(orientation=attitude(8.0), motion=True)
    assert end.motion is not None
    lean = np.deg2rad(8.0)
    assert end.motion.position[0, 0] == pytest.approx(
        (3.0, STANCE * np.sin(lean) + HEIGHT * np.cos(lean), 4.0))


# Motions


def test_a_motion_begins_with_the_landing_and_ends_at_rest() -> None:
    given = attitude(6.0, 35.0, 130.0)
    end = touch_down((0.4, -1.0, 0.3), given, (0.05, 0.0, 0.1), motion=True)
    path = end.motion
    assert path is not None
    assert path.orientation[0, 0] == pytest.approx(given, abs=1e-12)
    assert np.linalg.norm(path.orientation, axis=-1) == pytest.approx(1.0)
    assert path.orientation[-1] == pytest.approx(end.orientation)
    assert path.position[-1] == pytest.approx(end.position)
    assert path.linear_velocity[0, 0] == pytest.approx((0.4, -1.0, 0.3))
    # Only what turns in the plane: about (-0.6, 0, 0.8).
    assert path.angular_velocity[0, 0] == pytest.approx(0.05 * np.array([-0.6, 0.0, 0.8]))
    assert path.contact[-1].tolist() == [[True, True]]
    moved = np.diff(path.position[:, 0], axis=0) / 0.02
    # But for the ground, which undoes what feet have sunk in.
    assert moved[:, ::2] == pytest.approx(path.linear_velocity[1:, 0, ::2], abs=0.15)
    across = path.position[:, 0, ::2] - path.position[0, 0, ::2]
    assert across @ (-0.6, 0.8) == pytest.approx(0.0, abs=1e-9)
    upright = Rotation.from_quat(end.orientation[0])
    assert upright.apply((0, 1, 0))[1] == pytest.approx(1.0, abs=1e-6)
    turned = np.diff([Rotation.from_quat(q[0]).apply((0, 1, 0)) for q in path.orientation], axis=0)
    assert np.abs(turned).max() < 0.03


def test_rows_do_not_depend_on_each_other() -> None:
    velocity = np.array([(0.5, -1.0, 0.2), (2.0, -2.0, 0.0), (0.0, -0.1, 0.0)])
    arguments = (
        np.full((3, 3), 5.0), np.stack([attitude(lean) for lean in (5.0, 9.0, 0.0)]), velocity,
        np.zeros((3, 3)), np.full(3, 22_100.0))
    together = settle(*arguments, SETTINGS)
    first = settle(*(argument[:1] for argument in arguments), SETTINGS)
    assert np.array_equal(together.position[:1], first.position)
    assert np.array_equal(together.verdict[:1], first.verdict)


def test_no_landings_give_an_empty_result() -> None:
    none = settle(
        np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0),
        SETTINGS, motion=True)
    assert none.names() == []
    assert none.position.shape == (0, 3)


def test_settings_are_checked() -> None:
    assert touch_down(not_a_setting=3.0, engine_cutoff=1.0).names() == ['stands']
    with pytest.raises(ValueError, match='stance'):
        touch_down(stance=-1.0)


# Against the worlds


def test_landings_of_the_expert_stand() -> None:
    """They come to rest within 10 cm of the place of touchdown."""
    world = worlds.make('rocket', 100, seed=3, level=7)
    pilot = ExpertPilot(world.spec)
    seen = world.observe()
    finished = []
    for _ in range(700):
        seen, *_ = world.step(pilot(seen))
        finished.append(world.finished.take(world.finished.outcome == 0))
    landed = [state for state in finished if len(state.row)]
    position, orientation, velocity, spin, mass = (
        np.concatenate([getattr(state, name) for state in landed]) for name in (
            'position', 'orientation', 'linear_velocity', 'angular_velocity', 'mass'))
    assert len(mass) >= 100
    end = settle(position, orientation, velocity, spin, mass, world.spec.settings)
    assert set(end.names()) == {'stands'}
    assert np.abs(end.position - position).max() < 0.1


def test_settling_matches_the_touchdown_of_rocket_planar() -> None:
    """From its first contact on, save for the air."""
    world = worlds.make('rocket_planar', 1, air_density=0.0)
    lean = np.deg2rad(5.0)
    world.position[:2, 0] = (1.0, STANCE * np.sin(lean) + HEIGHT * np.cos(lean) + 0.005)
    world.velocity[:2, 0] = (1.2, -0.8)
    world.attitude[:, 0] = (0.0, 0.0, np.sin(lean / 2), np.cos(lean / 2))
    idle = np.array([[-1.0, 0.0, 0.0]])
    world.step(idle)
    at = world.telemetry(np.arange(1))
    assert at.contact.any()
    end = settle(
        at.position, at.orientation, at.linear_velocity, at.angular_velocity, at.mass,
        world.spec.settings)
    for _ in range(300):
        if world.step(idle)[2][0]:
            break
    assert world.spec.outcomes[world.finished.outcome[0]] == 'landed'
    assert end.position[0, 0] == pytest.approx(world.finished.position[0, 0], abs=0.02)


@pytest.mark.parametrize('speed', [35.0, 60.0])
def test_the_ground_extends_as_far_as_a_rocket_slides(speed: float) -> None:
    """Without friction it is still on the ground, and on its way, when its time is up."""
    end = touch_down((speed, 0.0, 0.0), foot_friction=0.0)
    assert end.position[0, 1] == pytest.approx(HEIGHT, abs=0.002)
    assert end.position[0, 0] == pytest.approx(3.0 + 5.0 * speed, rel=0.02)
    assert end.standing.tolist() == [False]


def test_a_heavier_rocket_turns_less() -> None:
    """For the same torque of friction, as inertia is a constant."""
    def turned(mass: float) -> float:
        end = settle(
            np.array([[0.0, 5.1, 0.0]]), attitude(8.0)[None], np.array([[1.0, -1.0, 0.0]]),
            np.zeros((1, 3)), np.array([mass]), SETTINGS, motion=True)
        assert end.motion is not None
        return float(end.motion.angular_velocity[5, 0, 2])

    assert abs(turned(22_000.0) - turned(24_000.0)) > 1e-3


def test_gravity_is_that_of_each_row() -> None:
    """It slides v^2 / (2 mu g) far, upright and on both feet: less where there is more of it."""
    gravity = np.array([0.5, 1.0, 2.0]) * G
    count = len(gravity)
    end = settle(
        np.tile((0.0, HEIGHT, 0.0), (count, 1)), np.tile(attitude(), (count, 1)),
        np.tile((2.0, 0.0, 0.0), (count, 1)), np.zeros((count, 3)), np.full(count, 23_000.0),
        SETTINGS | {'foot_friction': 0.3}, gravity=gravity)
    assert end.moved == pytest.approx(2.0**2 / (2 * 0.3 * gravity), abs=0.03)
