# SPDX-License-Identifier: Apache-2.0
"""Contact in planar worlds against closed forms: heights, friction, tipping, rebound, energy."""
from __future__ import annotations

import resource
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pymunk
import pytest
from numpy.typing import NDArray

from rocket_sim_node.worlds.lunar import spawn
from rocket_sim_node.worlds.lunar.spawn import Starts
from rocket_sim_node.worlds.lunar.vehicle import LunarDesign
from rocket_sim_node.worlds.planar.contact_model import PlanarContact
from rocket_sim_node.worlds.planar.vehicle import PlanarSettings
from rocket_sim_node.worlds.pymunk_batch.lane_block import Parts
from rocket_sim_node.worlds.pymunk_batch.lane_block import Solver
from rocket_sim_node.worlds.pymunk_batch.lanes import Lanes

F64 = NDArray[np.float64]

G = 9.81
MASS = 23_000.0
INERTIA = 5e5
STANCE, HEIGHT = 6.7, 5.2
SOLVER = Solver(iterations=10, slop=0.001, bias=(1 - 0.2) ** 50)


def lowest(angle: F64) -> F64:
    """Return how far the lower foot is below the origin, (K,) m."""
    return np.abs(np.sin(angle)) * STANCE + np.cos(angle) * HEIGHT


def touching(angle: float | F64, above: float = 0.0) -> F64:
    """Return poses (K, 3) of vehicles whose lower foot is `above` the ground."""
    angles = np.atleast_1d(np.asarray(angle, np.float64))
    return np.stack((np.zeros_like(angles), lowest(angles) + above, angles), axis=1)


def fly(
    pose: F64, velocity: F64, steps: int, down: F64 | None = None, **settings: Any,
) -> tuple[F64, F64, PlanarContact]:
    """Return poses and velocities (T, K, 3) of a passive touchdown, the first ones included."""
    contact = PlanarContact(len(pose), PlanarSettings(**settings))
    rows = np.arange(len(pose))
    contact.begin(rows, pose, velocity, np.full(len(pose), MASS))
    contact.step(rows[:0], np.zeros((0, 3)))
    pull = np.tile((0.0, -G, 0.0), (len(pose), 1)) if down is None else down
    poses, velocities = [pose], [velocity]
    for _ in range(steps):
        where, how = contact.step(rows, pull)
        poses.append(where)
        velocities.append(how)
    return np.stack(poses), np.stack(velocities), contact


def energy(pose: F64, velocity: F64) -> F64:
    """Return kinetic and potential energy, J."""
    return (
        0.5 * MASS * (velocity[..., 0]**2 + velocity[..., 1]**2)
        + 0.5 * INERTIA * velocity[..., 2]**2 + MASS * G * pose[..., 1])


# Standing


def test_a_vehicle_that_is_dropped_stands_on_both_feet_at_its_height() -> None:
    pose, velocity, contact = fly(touching(0.0, above=0.3), np.zeros((1, 3)), 150)
    assert -0.0012 < pose[-1, 0, 1] - HEIGHT <= 0.0
    assert abs(pose[-1, 0, 2]) < 1e-6
    assert np.abs(velocity[-1]).max() < 1e-6
    assert contact.feet.tolist() == [[True, True]]
    assert contact.hull.tolist() == [False]
    assert contact.resting.tolist() == [True]


def test_the_ground_carries_the_weight() -> None:
    """Impulses are those of the ground on the vehicle: upwards."""
    contact = fly(touching(0.0), np.zeros((1, 3)), 100)[2]
    assert contact.force[0] == pytest.approx((0.0, MASS * G), rel=1e-6, abs=1.0)


@pytest.mark.parametrize('sleeping', [False, True])
def test_a_vehicle_at_rest_stays_for_a_minute_sleeping_or_not(sleeping: bool) -> None:
    """Rest is found from velocities; whether pymunk may put a body to sleep makes no difference.

    On a slope of 0.3, below the friction of 0.6: sideways gravity does not creep it along.
    """
    contact = PlanarContact(1, PlanarSettings())
    if sleeping:
        for block in contact._lanes._blocks:
            block.space.sleep_time_threshold = 0.5
    contact.begin(np.array([0]), touching(0.0), np.zeros((1, 3)), np.array([MASS]))
    pull = np.array([[0.3 * G, -G, 0.0]])
    contact.step(np.zeros(0, np.int64), np.zeros((0, 3)))
    for _ in range(100):
        start = contact.step(np.array([0]), pull)[0]
    for _ in range(3000):
        pose, velocity = contact.step(np.array([0]), pull)
    assert contact.resting.all()
    assert pose == pytest.approx(start, abs=1e-3)
    assert np.abs(velocity).max() < 1e-6


@pytest.mark.parametrize('side', [-1, 1])
def test_contacts_are_where_the_feet_are(side: int) -> None:
    """A vehicle that leans to the left, a positive angle, touches with its left foot."""
    pose = touching(side * 0.1)
    pose[:, 1] -= 1e-4
    _, _, contact = fly(pose, np.zeros((1, 3)), 1)
    assert contact.feet.tolist() == [[side > 0, side < 0]]
    assert contact.hull.tolist() == [False]
    point = contact._lanes.contacts.point[0]
    foot = -side * STANCE * np.cos(0.1) + side * np.sin(0.1) * HEIGHT
    assert point == pytest.approx((foot, 0.0), abs=1e-3)
    assert contact.force[0, 1] > 0


def test_the_nose_touches_as_hull() -> None:
    pose = np.array([[0.0, 1.85, np.pi / 2]])
    contact = fly(pose, np.array([[0.0, -0.1, 0.0]]), 2)[2]
    assert contact.hull.tolist() == [True]


# Friction


def test_a_vehicle_slides_down_a_slope_iff_it_is_steeper_than_the_friction() -> None:
    """On flat ground with gravity inclined; sliding it accelerates by g (sin a - mu cos a)."""
    slope = np.arctan([0.55, 0.59, 0.61, 0.65])
    pull = G * np.stack((np.sin(slope), -np.cos(slope), np.zeros(4)), axis=1)
    pose, velocity, _ = fly(touching(np.zeros(4)), np.zeros((4, 3)), 100, pull)
    assert np.abs(pose[-1, :2, 0] - pose[20, :2, 0]).max() < 1e-5
    gained = velocity[-1, 2:, 0] - velocity[20, 2:, 0]
    expected = G * (np.sin(slope) - 0.6 * np.cos(slope))[2:] * 80 * 0.02
    assert gained == pytest.approx(expected, rel=0.01)


class Box:
    """A box on a slope. A `Design`."""

    bodies = 1
    lane_width = 64.0
    cell = 2.0

    def __init__(self, friction: float, slope: float) -> None:
        self.friction, self.slope = friction, slope

    def vehicle(self) -> Parts:
        body = pymunk.Body(2.0, pymunk.moment_for_box(2.0, (1.0, 0.5)))
        shape = pymunk.Poly.create_box(body, (1.0, 0.5))
        shape.friction = self.friction
        return Parts([body], [shape])

    def ground(self, body: pymunk.Body, origin: float) -> Sequence[pymunk.Shape]:
        edge = 20.0
        segment = pymunk.Segment(
            body, (origin - edge, -edge * self.slope), (origin + edge, edge * self.slope), 0.0)
        segment.friction = 1.0
        return [segment]


@pytest.mark.parametrize(('slope', 'slides'), [(0.45, False), (0.55, True)])
def test_a_box_slides_down_a_slope_iff_it_is_steeper_than_the_friction(
    slope: float, slides: bool,
) -> None:
    lanes = Lanes(3, Box(0.5, slope), 0.01, G, SOLVER)
    angle = np.arctan(slope)
    pose = np.zeros((3, 1, 3))
    pose[:, 0] = (-0.26 * np.sin(angle), 0.26 * np.cos(angle), angle)
    lanes.place(np.arange(3), pose, np.zeros((3, 1, 3)))
    for _ in range(200):
        lanes.step(np.zeros((3, 1, 3)))
    gone = np.hypot(*(lanes.pose - pose)[:, 0, :2].T)
    if slides:
        way = 0.5 * G * (np.sin(angle) - 0.5 * np.cos(angle)) * 2.0**2
        assert gone == pytest.approx(np.full(3, way), rel=0.05)
    else:
        assert gone.max() < 0.02


def test_a_vehicle_slides_as_far_as_friction_lets_it() -> None:
    """v^2 / (2 mu g)."""
    speed = np.array([1.0, 2.0, 3.0])
    velocity = np.stack((speed, np.zeros(3), np.zeros(3)), axis=1)
    pose, after, _ = fly(touching(np.zeros(3)), velocity, 400, dt=0.002)
    assert np.abs(after[-1, :, 0]).max() < 1e-6
    assert pose[-1, :, 0] == pytest.approx(speed**2 / (2 * 0.6 * G), rel=0.02)


# Tipping


def test_a_vehicle_rights_itself_up_to_the_angle_at_which_it_stands_on_one_foot() -> None:
    """atan(stance / height): there its centre of gravity is above the foot."""
    limit = np.arctan(STANCE / HEIGHT)
    angle = limit + np.deg2rad([-1.0, -0.3, 0.3, 1.0])
    pose, _, contact = fly(
        touching(angle), np.zeros((4, 3)), 600, foot_friction=10.0, foot_restitution=0.0)
    assert np.abs(pose[-1, :2, 2]).max() < 0.01
    assert contact.resting[:2].all()
    assert (pose[-1, 2:, 2] > np.deg2rad(80)).all()


def test_a_vehicle_trips_over_its_foot_at_the_critical_speed() -> None:
    """v^2 = 2 g (r - h) (I + m r^2) / (m h^2), r = hypot(stance, h).

    Its foot caught, it turns about that with an angular momentum of m v h, and has to lift its
    centre of gravity from h to r.
    """
    reach = np.hypot(STANCE, HEIGHT)
    critical = np.sqrt(
        2 * G * (reach - HEIGHT) * (INERTIA + MASS * reach**2) / (MASS * HEIGHT**2))
    speed = critical * np.array([0.9, 0.97, 1.03, 1.1])
    velocity = np.stack((speed, np.zeros(4), np.zeros(4)), axis=1)
    pose, _, _ = fly(
        touching(np.zeros(4)), velocity, 1500, dt=0.004, foot_friction=10.0,
        foot_restitution=0.0)
    over = np.abs(pose[:, :, 2]).max(0) > np.deg2rad(80)
    assert over.tolist() == [False, False, True, True]


# Rebound and energy


@pytest.mark.parametrize('restitution', [0.0, 0.3, 0.6])
def test_a_vehicle_rebounds_to_the_square_of_its_restitution(restitution: float) -> None:
    """e^2 h, for a drop from 1 m onto both feet."""
    speed = np.sqrt(2 * G * 1.0)
    pose, _, _ = fly(
        touching(0.0), np.array([[0.0, -speed, 0.0]]), 1000, dt=0.001,
        foot_restitution=restitution)
    height = pose[:, 0, 1].max() - HEIGHT
    assert height == pytest.approx(restitution**2, abs=0.01)


@pytest.mark.parametrize('restitution', [0.0, 0.1, 0.6])
def test_no_energy_is_gained_in_contact(restitution: float) -> None:
    """But for what lifts a vehicle out of the ground again, into which a step has brought it."""
    rng = np.random.default_rng(0)
    velocity = rng.uniform(-3, 3, (500, 3)) * (1.0, 1.0, 0.3)
    velocity[:, 1] = -np.abs(velocity[:, 1])
    pose, velocity, _ = fly(
        touching(rng.uniform(-0.6, 0.6, 500)), velocity, 250, foot_restitution=restitution)
    total = energy(pose, velocity)
    deepest = np.maximum.accumulate(np.maximum(lowest(pose[:, :, 2]) - pose[:, :, 1], 0.0))
    most_later = np.maximum.accumulate(total[::-1])[::-1]
    assert (most_later[1:] <= total[:-1] + MASS * G * deepest[:-1]).all()
    assert (total[-1] < total[0]).all()


# Independence


def touchdowns(count: int) -> tuple[F64, F64]:
    """Return poses and velocities (K, 3) of various touchdowns."""
    rng = np.random.default_rng(1)
    velocity = rng.uniform(-2.9, 2.9, (count, 3)) * (1.0, 1.0, 0.3)
    velocity[:, 1] = -np.abs(velocity[:, 1])
    return touching(rng.uniform(-0.5, 0.5, count)), velocity


def test_a_restarted_vehicle_does_not_change_its_neighbours() -> None:
    count, anew = 70, np.array([3, 33, 34])
    pose, velocity = touchdowns(count)
    rows, others = np.arange(count), np.setdiff1d(np.arange(count), anew)
    pull = np.tile((0.0, -G, 0.0), (count, 1))
    results: list[list[F64]] = []
    for disturbed in (False, True):
        contact = PlanarContact(count, PlanarSettings())
        contact.begin(rows, pose, velocity, np.full(count, MASS))
        contact.step(rows[:0], np.zeros((0, 3)))
        results.append([])
        for step in range(150):
            if disturbed and step % 11 == 5:
                contact.end(anew)
                contact.begin(
                    anew, pose[anew], -velocity[anew] + step, np.full(len(anew), 1e4))
            results[-1].append(np.hstack(contact.step(rows, pull))[others])
    assert np.array_equal(results[0], results[1])


def test_a_restarted_vehicle_equals_a_new_one_bit_for_bit() -> None:
    pose, velocity = touchdowns(64)
    rows = np.arange(64)
    pull = np.tile((0.0, -G, 0.0), (64, 1))
    mass = np.linspace(22_000.0, 24_000.0, 64)
    results = []
    for used in (False, True):
        contact = PlanarContact(64, PlanarSettings())
        if used:
            contact.begin(rows, pose[::-1], -velocity, np.full(64, MASS))
            for _ in range(37):
                contact.step(rows, pull)
            contact.end(rows)
        contact.begin(rows, pose, velocity, mass)
        contact.step(rows[:0], np.zeros((0, 3)))
        results.append([np.hstack(contact.step(rows, pull)) for _ in range(120)])
    assert np.array_equal(results[0], results[1])


def lunar(count: int) -> tuple[Lanes, Starts]:
    """Return lunar landers at their starts."""
    lanes = Lanes(count, LunarDesign(), 0.02, 10.0, Solver(20, 0.005, (1 - 0.2) ** 50))
    starts = Starts(3, count, 0.02, 10.0, 0.0)
    launch(lanes, starts, np.arange(count), 0)
    return lanes, starts


def launch(lanes: Lanes, starts: Starts, rows: NDArray[np.int64], episode: int) -> None:
    """Start an episode of lunar landers, terrain and all."""
    start = starts.take(rows, np.full(len(rows), episode))
    for row, terrain in zip(rows.tolist(), start.terrain, strict=True):
        spawn.shape_ground(lanes, row, terrain)
    lanes.place(rows, start.pose, start.velocity)


def test_restarted_lunar_landers_equal_new_ones() -> None:
    """Bit for bit, after crashes and tumbles; and their neighbours do not change."""
    rows, anew = np.arange(40), np.array([0, 7, 33])
    others = np.setdiff1d(rows, anew)
    force = np.zeros((40, 3, 3))
    fresh, starts = lunar(40)
    used, _ = lunar(40)
    for _ in range(190):
        fresh.step(force)
        used.step(force)
    assert len(used.contacts.row) > 40
    launch(used, starts, anew, 1)
    newest, _ = lunar(40)
    launch(newest, starts, rows, 1)
    for _ in range(200):
        for lanes in (fresh, used, newest):
            lanes.step(force)
        assert np.array_equal(fresh.pose[others], used.pose[others])
        assert np.array_equal(fresh.velocity[others], used.velocity[others])
        assert np.array_equal(newest.pose[anew], used.pose[anew])
        assert np.array_equal(newest.velocity[anew], used.velocity[anew])


# Resources


def resident() -> float:
    """Return the memory of this process that is in use, MB."""
    pages = int(Path('/proc/self/statm').read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def parts(lanes: Lanes) -> list[tuple[int, int, int]]:
    """Return the numbers of bodies, shapes and joints in each Space."""
    return [
        (len(space.bodies), len(space.shapes), len(space.constraints))
        for space in (block.space for block in lanes._blocks)]


@pytest.mark.slow
def test_a_hundred_thousand_touchdowns_leave_nothing_behind() -> None:
    count, rounds = 250, 400
    pose, velocity = touchdowns(count)
    rows = np.arange(count)
    pull = np.tile((0.0, -G, 0.0), (count, 1))
    contact = PlanarContact(count, PlanarSettings())
    before = parts(contact._lanes)
    for round_ in range(rounds):
        contact.begin(rows, pose, velocity, np.full(count, MASS))
        for _ in range(3):
            contact.step(rows, pull)
        assert contact.feet.any()
        contact.end(rows)
        if round_ == rounds // 4:
            memory = resident()
    assert parts(contact._lanes) == before
    assert resident() - memory < 4.0


@pytest.mark.slow
def test_fifty_thousand_lunar_landers_leave_nothing_behind() -> None:
    """All over the field: the spatial hash forgets ground that has moved where it looks."""
    count, rounds = 200, 250
    rows, rng = np.arange(count), np.random.default_rng(0)
    lanes, starts = lunar(count)
    before = parts(lanes)
    touched = 0
    for round_ in range(rounds):
        launch(lanes, starts, rows, round_)
        pose = lanes.pose.copy()
        pose[:, :, :2] -= rng.uniform((-9.0, 0.0), (9.0, 10.0), (count, 1, 2))
        lanes.place(rows, pose, lanes.velocity.copy())
        for _ in range(3):
            lanes.step(np.zeros((count, 3, 3)))
        touched += len(lanes.contacts.row)
        if round_ == rounds // 2:
            memory = resident()
    assert touched > 1000
    assert parts(lanes) == before
    assert resident() - memory < 4.0


def test_rest_needs_both_feet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Still on one foot, as at the height of a bounce or in balance, is not at rest."""
    contact = PlanarContact(1, PlanarSettings())
    contact.begin(np.array([0]), touching(0.0), np.zeros((1, 3)), np.array([MASS]))
    contact.step(np.zeros(0, np.int64), np.zeros((0, 3)))
    touch = contact._touch

    def one_foot(pose: F64) -> None:
        touch(pose)
        contact.feet[:, 1] = False

    monkeypatch.setattr(contact, '_touch', one_foot)
    for _ in range(100):
        contact.step(np.array([0]), np.array([[0.0, -G, 0.0]]))
    assert contact.still.tolist() == [0]
