# SPDX-License-Identifier: Apache-2.0
"""Contact of rockets in a vertical plane with flat ground: feet and hull, simulated by pymunk.

The model handles vehicles between first contact and rest only. They enter with pose, velocity and
mass. At each step the caller gives their acceleration without the ground: gravity, air, engine. x
is counted from the point of touchdown, so that every lane is as narrow as a touchdown.
"""
from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.planar import vehicle
from rocket_sim_node.worlds.planar.vehicle import PlanarDesign
from rocket_sim_node.worlds.planar.vehicle import PlanarSettings
from rocket_sim_node.worlds.pymunk_batch.lane_block import Solver
from rocket_sim_node.worlds.pymunk_batch.lanes import Lanes

_SLOP = 0.001
"""m, penetration of the feet at rest."""
_BIAS = (1 - 0.2) ** 50
"""Part of a penetration that remains after 1 s: a fifth is removed in 0.02 s."""
_AWAY = 1e4
"""m, height at which vehicles that are not in touchdown are parked."""
_LOST = 5e5
"""m, m/s, rad or rad/s: far beyond any vehicle in touchdown; half the limit of `Lanes`."""

Rows = NDArray[np.integer]


def heights(points: F64, y: F64, sin: F64, cos: F64) -> F64:
    """Return the heights of points on vehicles, `(K, P)` m.

    :param points: `(P, 2)` m, relative to the vehicle's origin.
    :param y: `(K,)` m, height of the origin.
    :param sin: `(K,)` and `cos` `(K,)` of the vehicle's angle.
    """
    lifted: F64 = y[:, None] + sin[:, None] * points[:, 0] + cos[:, None] * points[:, 1]
    return lifted


def rest_steps(settings: PlanarSettings) -> int:
    """Return the number of steps at rest after which a vehicle has landed, at least one."""
    return max(1, int(np.ceil(settings.rest_time / settings.dt - 1e-9)))


class PlanarContact:
    """Contact state of N vehicles, each of which may be in touchdown.

    `feet` `(N, 2)` left and right foot and `hull` `(N,)`: contacts of the last step; `force`
    `(N, 2)` N of the ground, mean over that step; `mass` `(N,)` kg; `still` `(N,)` number of steps
    at rest, on both feet or lying; `present` `(N,)` whether in touchdown; `lost` `(N,)` whether
    the position is impossible, as after a forged snapshot.
    """

    def __init__(self, count: int, settings: PlanarSettings) -> None:
        """Create N = `count` vehicles."""
        self._dt, self._inertia = settings.dt, settings.inertia
        self._lanes = Lanes(
            count, PlanarDesign(settings), settings.dt, 0.0,
            Solver(iterations=10, slop=_SLOP, bias=_BIAS))
        # Feet are below the origin, the hull is above.
        self._middle = (vehicle.hull_bottom(settings) - settings.touchdown_height) / 2
        self._rest_speed, self._rest_spin = settings.rest_speed, np.deg2rad(settings.rest_spin)
        self._rest_steps = rest_steps(settings)
        self._push = np.zeros((count, 1, 3))
        self._start_x = np.zeros(count)
        self.feet = np.zeros((count, 2), np.bool_)
        self.hull = np.zeros(count, np.bool_)
        self.force = np.zeros((count, 2))
        self.still = np.zeros(count, np.int64)
        self.mass = np.full(count, settings.dry_mass)
        self.present = np.ones(count, np.bool_)
        self.lost = np.zeros(count, np.bool_)
        self.end(np.arange(count))

    def begin(self, rows: Rows, pose: F64, velocity: F64, mass: F64) -> None:
        """Start touchdowns; after the next step the vehicles are at the given poses.

        In the step in which a vehicle is placed it is out of reach of the ground and moves by its
        velocity, so it is placed one step's motion back.

        :param rows: `(K,)` vehicles.
        :param pose: `(K, 3)` m, m, rad of the origins; a foot or corner is at the ground or in it.
        :param velocity: `(K, 3)` m/s, m/s, rad/s.
        :param mass: `(K,)` kg, constant for the whole touchdown.
        """
        self._start_x[rows] = pose[:, 0]
        back = pose - velocity * self._dt
        back[:, 0] -= pose[:, 0]
        self._lanes.place(rows, back[:, None], velocity[:, None])
        self.present[rows] = True
        self.mass[rows] = mass
        self._weigh(rows)

    def end(self, rows: Rows) -> None:
        """Remove vehicles from the ground, if they are in touchdown."""
        rows = rows[self.present[rows]]
        if not rows.size:
            return
        self.present[rows] = self.lost[rows] = False
        away = np.zeros((len(rows), 1, 3))
        away[:, :, 1] = _AWAY
        self._lanes.place(rows, away, np.zeros_like(away))
        self.feet[rows] = self.hull[rows] = False
        self.force[rows] = 0.0
        self.still[rows] = 0
        self._start_x[rows] = 0.0

    def _weigh(self, rows: Rows) -> None:
        """Set the vehicles' masses in pymunk."""
        for row, mass in zip(rows.tolist(), self.mass[rows].tolist(), strict=True):
            self._lanes.vehicle(row).bodies[0].mass = mass

    def step(self, rows: Rows, acceleration: F64) -> tuple[F64, F64]:
        """Advance by dt; return pose `(K, 3)` and velocity `(K, 3)` of the selected vehicles.

        :param rows: `(K,)` vehicles that were in touchdown before this step.
        :param acceleration: `(K, 3)` m/s^2, m/s^2, rad/s^2 without the ground.
        """
        lanes, push = self._lanes, self._push
        mass = self.mass[rows]
        push.fill(0.0)
        push[rows, 0, :2] = acceleration[:, :2] * mass[:, None]
        push[rows, 0, 2] = acceleration[:, 2] * self._inertia
        before = lanes.pose[:, 0]
        lanes.step(push)
        self._touch(before)
        far = sum(np.einsum('nbk,nbk->n', part, part) for part in (lanes.pose, lanes.velocity))
        self.lost = ~(far <= _LOST**2)
        pose, velocity = lanes.pose[rows, 0], lanes.velocity[rows, 0]
        pose[:, 0] += self._start_x[rows]
        still = (
            (self.feet[rows].all(1) | self.hull[rows])
            & (np.hypot(velocity[:, 0], velocity[:, 1]) < self._rest_speed)
            & (np.abs(velocity[:, 2]) < self._rest_spin))
        self.still[rows] = np.where(still, self.still[rows] + 1, 0)
        return pose, velocity

    def _touch(self, pose: F64) -> None:
        """Record the contacts with the ground.

        :param pose: `(N, 3)` of the vehicles when contacts were detected.
        """
        self.feet[:] = False
        self.hull[:] = False
        self.force[:] = 0.0
        touch = self._lanes.contacts
        row = touch.row
        if not len(row):
            return
        away_x, away_y = (touch.point - pose[row, :2]).T
        sin, cos = np.sin(pose[row, 2]), np.cos(pose[row, 2])
        foot = cos * away_y - sin * away_x < self._middle
        side = np.where(cos * away_x + sin * away_y < 0, vehicle.LEFT, vehicle.RIGHT)
        self.feet[row[foot], side[foot]] = True
        self.hull[row[~foot]] = True
        np.add.at(self.force, row, touch.impulse / self._dt)

    @property
    def resting(self) -> NDArray[np.bool_]:
        """`(N,)` whether the vehicle has been still for long enough to count as at rest."""
        return self.still >= self._rest_steps

    # Snapshots

    def forget(self) -> None:
        """Clear the contact solver's memory, as `load` does."""
        self._lanes.forget()

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the complete state, as `load` takes it."""
        return {
            'present': self.present, 'start_x': self._start_x, 'still': self.still,
            'mass': self.mass,
            **{f'lanes_{name}': array for name, array in self._lanes.arrays().items()}}

    def check(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Check arrays for `load`.

        :raises ValueError: when a vehicle has an impossible position.
        """
        lanes = self._of_lanes(arrays)
        self._lanes.check(**lanes)
        absent = ~arrays['present']
        away = (0.0, _AWAY, 0.0, 0.0, 0.0, 0.0)
        # In the first step of parking, the body is not at the parking height yet.
        there = np.concatenate((lanes['pose'], lanes['velocity']), axis=2)[absent]
        if (there != away).any() or (lanes['bodies'][absent & ~lanes['fresh']] != away).any():
            raise ValueError('snapshot: contact_lanes has a vehicle in flight in a lane that is '
                'not waiting')

    @staticmethod
    def _of_lanes(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        return {
            name.removeprefix('lanes_'): array for name, array in arrays.items()
            if name.startswith('lanes_')}

    def load(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Restore the state from `arrays`."""
        self._start_x[:], self.still[:] = arrays['start_x'], arrays['still']
        self.mass[:], self.present[:] = arrays['mass'], arrays['present']
        self._weigh(np.arange(len(self.mass)))
        self._lanes.load(**self._of_lanes(arrays))
        self.feet[:] = False
        self.hull[:] = self.lost[:] = False
        self.force[:] = 0.0
