# SPDX-License-Identifier: Apache-2.0
"""Simulation of a 3-D rocket after touchdown: whether it stays standing, and where.

World `rocket` ends at touchdown. For evaluations and recordings the contact model of
`rocket_planar` continues from there, with engine and RCS off, in one vertical plane for each
landing (see LandingPlane), as in the classic planar landing-stability analyses.

The projection leaves out lean, spin and (where the lean decides) velocity across the plane; yaw;
the direction of the four legs, as in every plane two lead and two trail; and the air, with
sideways forces of conditions. Touchdown is judged by the height of the origin. By then a foot may
be in the ground, because of tilt or the length of the last step: the vehicle is lifted until it
just touches. Legs are rigid and do not break: for a landing that was too fast, the verdict says
what would happen if they held.
"""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node import settings as settings_module
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.planar import contact_model
from rocket_sim_node.worlds.planar import vehicle
from rocket_sim_node.worlds.planar.contact_model import PlanarContact
from rocket_sim_node.worlds.planar.landing_plane import LandingPlane
from rocket_sim_node.worlds.planar.vehicle import PlanarSettings

VERDICTS = ('stands', 'slides', 'bounces', 'tips_over')
STANDS, SLIDES, BOUNCES, TIPS_OVER = range(4)

BOUNCE_HEIGHT = 0.01
"""m, height of the lower foot above the ground from which on it is a bounce."""
SLIDE_LENGTH = 0.1
"""m, distance slid by the foot that touched first from which on it is a slide."""
BLEND_TIME = 0.5
"""s, over which the lean across the plane fades out of a motion."""


@dataclass(frozen=True)
class Motion:
    """K touchdowns at T times, dt apart, the first at first contact; for recordings.

    Vectors are `(T, K, 3)`, `orientation` `(T, K, 4)` x y z w, `contact` `(T, K, 2)` left and
    right foot in the plane. Yaw is kept; the lean across the plane fades out within BLEND_TIME.
    A rocket at rest stays where it is; `length` `(K,)` is the number of times until that is known.
    """

    position: F64
    orientation: F64
    linear_velocity: F64
    angular_velocity: F64
    contact: NDArray[np.bool_]
    length: NDArray[np.int64]


@dataclass(frozen=True)
class Settlement:
    """Results of K touchdowns; arrays `(K,)` unless a shape is given.

    `verdict` is an index into VERDICTS. A rocket at rest on both feet and upright, whose hull has
    never touched the ground, is `standing`; any other `tips_over`. A standing rocket `bounces` if
    both feet were above BOUNCE_HEIGHT; otherwise it `slides` if its first foot has moved by more
    than SLIDE_LENGTH; otherwise it `stands`.
    """

    verdict: NDArray[np.uint8]
    standing: NDArray[np.bool_]
    position: F64
    """`(K, 3)` m, at rest or at the time limit."""
    orientation: F64
    """`(K, 4)` quaternion x y z w, at that time; without the lean across the plane."""
    tilt: F64
    """deg from vertical, at that time."""
    time: F64
    """s from first contact until rest, or the time limit."""
    moved: F64
    """m along the ground, of the foot that touched first."""
    rebound: F64
    """m, greatest height of the lower foot."""
    plane: F64
    """`(K, 2)` x and z of the plane's horizontal direction."""
    motion: Motion | None

    def names(self) -> list[str]:
        """Return the verdicts by name."""
        return [VERDICTS[code] for code in self.verdict.tolist()]


class _Course(NamedTuple):
    """Motion of K touchdowns, each in its plane; the last axis is x, y, angle or their rates."""

    steps: NDArray[np.int64]
    """Steps until it was still."""
    followed: NDArray[np.int64]
    """Steps until it had been still for long enough to count as at rest."""
    resting: NDArray[np.bool_]
    hull: NDArray[np.bool_]
    rebound: F64
    pose: list[F64]
    """T arrays `(K, 3)`."""
    velocity: list[F64]
    contact: list[NDArray[np.bool_]]


def settle(
    position: F64, orientation: F64, velocity: F64, spin: F64, mass: F64,
    settings: Mapping[str, float], motion: bool = False, gravity: F64 | None = None,
) -> Settlement:
    """Simulate K rockets from touchdown until they are at rest, with engine and RCS off.

    :param position: `(K, 3)` m, y up; this and the following are at the end of an episode of
        `rocket`.
    :param orientation: `(K, 4)` quaternion x y z w.
    :param velocity: `(K, 3)` m/s.
    :param spin: `(K, 3)` rad/s.
    :param mass: `(K,)` kg, including remaining fuel.
    :param settings: those of world `rocket`, and non-default settings of the legs; others are
        ignored.
    :param motion: whether to return all times.
    :param gravity: `(K,)` m/s^2; by default from the settings.
    :raises ValueError: for a setting out of range.
    """
    s = settings_module.build(PlanarSettings, {
        info.name: settings_module.from_number(info, settings[info.name])
        for info in settings_module.describe(PlanarSettings)
        if info.name in settings and info.name != 'engine_cutoff'})
    plane = LandingPlane(position, orientation, velocity)
    feet = np.array(vehicle.feet(s))
    corners = np.array([*feet, *vehicle.hull(s)])
    zero = np.zeros_like(plane.lean)
    below = contact_model.heights(corners, zero, np.sin(plane.lean), np.cos(plane.lean)).min(1)
    first = np.stack((zero, -below, plane.lean), axis=1)
    pull = np.full(len(mass), s.gravity) if gravity is None else gravity
    course = _touch_down(first, plane.rates(velocity, spin), mass, pull, feet, s)
    last = course.pose[-1]
    foot = feet[np.where(plane.lean > 0, vehicle.LEFT, vehicle.RIGHT)]
    moved = np.abs(_foot_x(last, foot) - _foot_x(first, foot))
    tilt = np.abs(np.rad2deg(np.arctan2(np.sin(last[:, 2]), np.cos(last[:, 2]))))
    standing = course.resting & ~course.hull & (tilt < s.landed_tilt)
    verdict = np.full(len(mass), STANDS, np.uint8)
    verdict[moved > SLIDE_LENGTH] = SLIDES
    verdict[course.rebound > BOUNCE_HEIGHT] = BOUNCES
    verdict[~standing] = TIPS_OVER
    return Settlement(
        verdict=verdict, standing=standing, position=plane.place(last[:, 0], last[:, 1]),
        orientation=plane.orientation(last[:, 2]), tilt=tilt,
        time=course.steps.astype(np.float64) * s.dt, moved=moved,
        rebound=course.rebound, plane=plane.direction.T,
        motion=_in_space(course, plane, s.dt) if motion else None)


def _foot_x(pose: F64, foot: F64) -> F64:
    """Return the x coordinates of the feet `(K, 2)` of vehicles, `(K,)` m."""
    where: F64 = pose[:, 0] + np.cos(pose[:, 2]) * foot[:, 0] - np.sin(pose[:, 2]) * foot[:, 1]
    return where


def _touch_down(
    pose: F64, velocity: F64, mass: F64, gravity: F64, feet: F64, s: PlanarSettings,
) -> _Course:
    """Simulate vehicles in their planes until all are at rest or the time limit is reached."""
    count = len(mass)
    most = max(1, int(np.floor(s.touchdown_limit / s.dt + 1e-9)))
    course = _Course(
        np.full(count, most), np.full(count, most), np.zeros(count, np.bool_),
        np.zeros(count, np.bool_), np.zeros(count), [pose], [velocity],
        [np.zeros((count, 2), np.bool_)])
    rows = np.arange(count)
    if not count:
        return course
    contact, falling = PlanarContact(count, s), np.zeros((count, 3))
    falling[:, 1] = -gravity
    contact.begin(rows, pose, velocity, mass)
    contact.step(rows[:0], np.zeros((0, 3)))
    for step in range(1, most + 1):
        pose, velocity = course.pose[-1].copy(), np.zeros_like(velocity)
        pose[rows], velocity[rows] = contact.step(rows, falling[rows])
        touching = course.contact[-1].copy()
        touching[rows] = contact.feet[rows]
        course.hull[rows] |= contact.hull[rows]
        angle = pose[rows, 2]
        height = contact_model.heights(feet, pose[rows, 1], np.sin(angle), np.cos(angle)).min(1)
        course.rebound[rows] = np.maximum(course.rebound[rows], height)
        done = contact.resting[rows]
        course.resting[rows[done]] = True
        course.steps[rows[done]] = step - contact.still[rows[done]]
        course.followed[rows[done]] = step
        contact.end(rows[done])
        rows = rows[~done]
        course.pose.append(pose)
        course.velocity.append(velocity)
        course.contact.append(touching)
        if not rows.size:
            break
    return course


def _in_space(course: _Course, plane: LandingPlane, dt: float) -> Motion:
    """Convert motion within planes to 3-D."""
    moments = range(len(course.pose))
    left = [max(0.0, 1.0 - moment * dt / BLEND_TIME) for moment in moments]
    return Motion(
        position=np.stack([plane.place(pose[:, 0], pose[:, 1]) for pose in course.pose]),
        orientation=np.stack([
            plane.orientation(pose[:, 2], across)
            for pose, across in zip(course.pose, left, strict=True)]),
        linear_velocity=np.stack([
            plane.vector(velocity[:, 0], velocity[:, 1]) for velocity in course.velocity]),
        angular_velocity=np.stack([plane.spin(velocity[:, 2]) for velocity in course.velocity]),
        contact=np.stack(course.contact),
        length=course.followed + 1,
    )
