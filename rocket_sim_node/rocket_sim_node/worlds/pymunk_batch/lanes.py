# SPDX-License-Identifier: Apache-2.0
"""Many planar vehicles in a few pymunk Spaces: stepped, read and pushed in batches.

A Space holds a block of vehicles in lanes so wide that no two meet. Python runs one step, two
batch reads and one batch write per Space, not per vehicle, and a few property calls when a vehicle
is placed. The Spaces may be shared out among threads: Chipmunk runs without Python's global lock,
and as Spaces share nothing, the bits are those of one thread.

Chipmunk, inside pymunk, moves first and pushes afterwards: x += v dt, then contacts, then
v += a dt and the impulses of contacts and joints. Split between moving and detecting contacts,
the same loop is semi-implicit Euler, which moves with the new velocity. So the pose reported here
is one motion ahead of Chipmunk's: `pose` = Chipmunk's + v dt.

Chipmunk's state beside pose and velocity (impulses of joints and contacts for warm starts, and
penetration still to be corrected) can be neither read nor written. So a vehicle that is placed
spends its first step out of reach of the ground with its joints off, which clears that state, and
NumPy moves it as one rigid body meanwhile: no episode depends on the one before. `forget` clears
the state of all vehicles at once, so that a world restored from a snapshot goes on like the
original. The next step then solves all impulses from 0, with more iterations.

No vehicle depends on its neighbours, bit for bit: see LaneBlock on the order of contacts.
"""
from __future__ import annotations

import itertools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import pymunk
from numpy.typing import NDArray
from pymunk import batch

from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.pymunk_batch import lane_block
from rocket_sim_node.worlds.pymunk_batch.lane_block import LANES
from rocket_sim_node.worlds.pymunk_batch.lane_block import Design
from rocket_sim_node.worlds.pymunk_batch.lane_block import LaneBlock
from rocket_sim_node.worlds.pymunk_batch.lane_block import Parts
from rocket_sim_node.worlds.pymunk_batch.lane_block import Solver

_PARK = 1e4
"""m above its target, where a vehicle spends the step that clears its solver state."""
_FARTHEST = 1e6
"""m, m/s, rad or rad/s: far beyond any vehicle; hashing far greater values would overflow."""

Rows = NDArray[np.integer]


class Contacts(NamedTuple):
    """K contacts of vehicles with their ground in the last step, by row and body."""

    row: NDArray[np.int64]
    """`(K,)` vehicle."""
    body: NDArray[np.int64]
    """`(K,)` index of its body."""
    point: F64
    """`(K, 2)` m, relative to the lane's origin."""
    impulse: F64
    """`(K, 2)` N s, of the ground on the vehicle."""


_NO_CONTACTS = Contacts(
    np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2)))


class _Share:
    """Consecutive Spaces that one thread steps."""

    def __init__(self, blocks: Sequence[LaneBlock]) -> None:
        """Take the Spaces."""
        self._blocks = blocks
        self._bodies, self._arbiters = batch.Buffer(), batch.Buffer()

    def step(self, dt: float) -> None:
        """Push and step the Spaces, then read the poses and velocities, and the contacts."""
        self._bodies.clear()
        self._arbiters.clear()
        for block in self._blocks:
            block.set_push()
            block.space.step(dt)
        for block in self._blocks:
            batch.get_space_bodies(block.space, lane_block.STATE, self._bodies)
            batch.get_space_arbiters(block.space, lane_block.TOUCH, self._arbiters)

    def bodies(self) -> F64:
        """Return the states of all bodies after the step, `(M, 6)`, static ones included."""
        return np.frombuffer(self._bodies.float_buf()).reshape(-1, 6)

    @property
    def touches(self) -> bool:
        """Whether any vehicle touches the ground."""
        return len(self._arbiters.int_buf()) > 0

    def touching(self) -> tuple[NDArray[np.uintp], F64]:
        """Return the ids `(K, 2)` of bodies in contact, and impulses and points `(K, 4)`."""
        return (np.frombuffer(self._arbiters.int_buf(), np.uintp).reshape(-1, 2),
                np.frombuffer(self._arbiters.float_buf()).reshape(-1, 4))


class Lanes:
    """N vehicles of B bodies each, in lanes of their own; positions are relative to the lane.

    `pose` `(N, B, 3)`: x, y (m), angle (rad); `velocity` `(N, B, 3)`: m/s, rad/s; of each body's
    centre of gravity.
    """

    def __init__(
        self, count: int, design: Design, dt: float, gravity: float, solver: Solver,
        threads: int = 1,
    ) -> None:
        """Create N = `count` vehicles; `place` sets their positions.

        :param threads: how many threads share the Spaces, at most one for each.
        """
        self._dt, self._gravity = dt, gravity
        bodies = design.bodies
        firsts = range(0, count, LANES)
        lanes = [min(LANES, count - first) for first in firsts]
        ends = np.cumsum([n * bodies + 1 for n in lanes])
        # All bodies of all Spaces; each Space writes its own part.
        self._state, self._push = np.zeros((ends[-1], 6)), np.zeros((ends[-1], 3))
        self._blocks = [
            LaneBlock(
                design, n, gravity, solver,
                self._state[end - n * bodies - 1:end], self._push[end - n * bodies - 1:end])
            for n, end in zip(lanes, ends.tolist(), strict=True)]
        row = np.arange(count)
        self._lane = row % LANES
        # Skips the static body of each earlier Space.
        self._index = row[:, None] * bodies + np.arange(bodies) + (row // LANES)[:, None]
        self._origin = self._lane * design.lane_width
        self._fresh = np.zeros(count, np.bool_)
        self._cold = False
        self.pose = np.zeros((count, bodies, 3))
        self.velocity = np.zeros((count, bodies, 3))
        number = min(threads, len(self._blocks))
        cuts = [len(self._blocks) * k // number for k in range(number + 1)]
        self._shares = [_Share(self._blocks[a:b]) for a, b in itertools.pairwise(cuts)]
        self._pool = ThreadPoolExecutor(number - 1, 'lanes') if number > 1 else None
        # As designed; a body whose mass changes must not be pushed in the step after `place`.
        first = self.vehicle(0).bodies
        self._mass = np.array([body.mass for body in first])
        self._moment = np.array([body.moment for body in first])
        ids = np.array(
            [[body.id for body in self.vehicle(k).bodies] for k in range(count)], np.uintp)
        self._by_id = np.argsort(ids, axis=None)
        self._ids = ids.ravel()[self._by_id]
        self._contacts: Contacts | None = None

    def vehicle(self, row: int) -> Parts:
        """Return the parts of a vehicle."""
        return self._blocks[row // LANES].vehicles[row % LANES]

    def ground(self, row: int) -> tuple[Sequence[pymunk.Shape], float]:
        """Return the shapes of a lane's ground, and the lane's origin in their x coordinate, m.

        Call `reindex` after moving any of them.
        """
        return self._blocks[row // LANES].grounds[row % LANES], float(self._origin[row])

    def reindex(self, row: int, moved: Sequence[pymunk.Shape]) -> None:
        """Update the index after ground of a lane has moved; in the same order for every lane."""
        self._blocks[row // LANES].reindex(moved)

    # Stepping

    def step(self, force: F64) -> None:
        """Advance all vehicles by dt, under gravity and the forces given.

        :param force: `(N, B, 3)` N along world x and y, N m, at each body's centre of gravity.
        """
        fresh = self._fresh.nonzero()[0]
        self._push[self._index] = force
        self._step_shares()
        if self._cold:
            self._use_iterations(cold=False)
        if fresh.size:
            self._let_go(fresh, force[fresh])
        state = self._state[self._index]
        self.velocity = state[:, :, 3:]
        self.pose = state[:, :, :3] + self.velocity * self._dt
        self.pose[:, :, 0] -= self._origin[:, None]

    def _use_iterations(self, cold: bool) -> None:
        self._cold = cold
        for block in self._blocks:
            block.use_iterations(cold)

    def _step_shares(self) -> None:
        """Step all Spaces and read them, the first share in this thread."""
        others = [
            self._pool.submit(share.step, self._dt) for share in self._shares[1:]
        ] if self._pool else []
        self._shares[0].step(self._dt)
        for other in others:
            other.result()
        np.concatenate([share.bodies() for share in self._shares], out=self._state)
        self._contacts = None

    @property
    def contacts(self) -> Contacts:
        """Return the contacts with the ground in the last step."""
        if self._contacts is None:
            touching = [share.touching() for share in self._shares if share.touches]
            if not touching:
                self._contacts = _NO_CONTACTS
                return self._contacts
            ids, values = map(np.concatenate, zip(*touching, strict=True))
            place = np.minimum(np.searchsorted(self._ids, ids), len(self._ids) - 1)
            # In each pair one body is a vehicle's and the other is the static one.
            second = (self._ids[place[:, 1]] == ids[:, 1]).astype(np.int64)
            which = self._by_id[place[np.arange(len(ids)), second]]
            row, body = np.divmod(which, self.pose.shape[1])
            point = values[:, 2:].copy()
            point[:, 0] -= self._origin[row]
            impulse = values[:, :2] * np.where(second, -1.0, 1.0)[:, None]
            # Chipmunk's own order depends on memory addresses.
            order = np.lexsort((point[:, 1], point[:, 0], body, row))
            self._contacts = Contacts(row[order], body[order], point[order], impulse[order])
        return self._contacts

    # Placing

    def place(self, rows: Rows, pose: F64, velocity: F64) -> None:
        """Place vehicles in the air, without memory of earlier contacts.

        :param rows: `(K,)` vehicles.
        :param pose: `(K, B, 3)` m, rad.
        :param velocity: `(K, B, 3)` m/s, rad/s; such that the vehicle moves as one rigid body.
        """
        self.pose[rows] = pose
        self.velocity[rows] = velocity
        self._fresh[rows] = True
        parked = np.zeros((*pose.shape[:2], 6))
        parked[:, :, :3] = pose
        parked[:, :, 0] += self._origin[rows][:, None]
        parked[:, :, 1] += _PARK
        self._write(rows, parked, hold=False)

    def _let_go(self, rows: Rows, force: F64) -> None:
        """End the step after `place`: move vehicles as rigid bodies, switch joints on."""
        pose, velocity = self.pose[rows], self.velocity[rows]
        mass, total = self._mass[:, None], self._mass.sum()
        centre = (mass * pose[:, :, :2]).sum(1) / total
        arm = pose[:, :, :2] - centre[:, None]
        torque = (
            force[:, :, 2] + arm[:, :, 0] * force[:, :, 1] - arm[:, :, 1] * force[:, :, 0]).sum(1)
        moment = (self._moment + self._mass * (arm**2).sum(2)).sum(1)
        spin = velocity[:, 0, 2] + self._dt * torque / moment
        drift = (mass * velocity[:, :, :2]).sum(1) / total
        drift += self._dt * force[:, :, :2].sum(1) / total
        drift[:, 1] -= self._dt * self._gravity
        state = np.empty((*pose.shape[:2], 6))
        state[:, :, :3] = pose
        state[:, :, 0] += self._origin[rows][:, None]
        state[:, :, 3] = drift[:, :1] - spin[:, None] * arm[:, :, 1]
        state[:, :, 4] = drift[:, 1:] + spin[:, None] * arm[:, :, 0]
        state[:, :, 5] = spin[:, None]
        self._write(rows, state, hold=True)
        self._fresh[rows] = False

    def _write(self, rows: Rows, state: F64, hold: bool) -> None:
        """Write Chipmunk's state `(K, B, 6)` of vehicles, with joints switched on or off."""
        self._state[self._index[rows]] = state
        chosen = rows.tolist()
        for row in chosen:
            self._blocks[row // LANES].hold(row % LANES, hold)
        for number in {row // LANES for row in chosen}:
            self._blocks[number].set_state()

    # Snapshots

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return copies of the complete state after `forget`, as `load` takes it."""
        return {
            'bodies': self._local_state(), 'pose': self.pose.copy(),
            'velocity': self.velocity.copy(), 'fresh': self._fresh.copy()}

    def _local_state(self) -> F64:
        """Return Chipmunk's states `(N, B, 6)`, relative to the lanes.

        The origins are integers, so subtracting and adding them does not round.
        """
        state: F64 = self._state[self._index]
        state[:, :, 0] -= self._origin[:, None]
        return state

    @staticmethod
    def check(bodies: F64, pose: F64, velocity: F64, fresh: NDArray[np.bool_]) -> None:
        """Check arrays for `load`.

        :raises ValueError: when a vehicle has an impossible position.
        """
        for name, array in (('bodies', bodies), ('pose', pose), ('velocity', velocity)):
            if (np.abs(array) > _FARTHEST).any():
                raise ValueError(f'snapshot: {name} has a value beyond {_FARTHEST:g}')

    def load(self, bodies: F64, pose: F64, velocity: F64, fresh: NDArray[np.bool_]) -> None:
        """Restore all vehicles from `arrays`, and clear the solver's memory."""
        self.pose, self.velocity = pose.copy(), velocity.copy()
        self._fresh = fresh.copy()
        state = bodies.copy()
        state[:, :, 0] += self._origin[:, None]
        self._state[self._index] = state
        self.forget()

    def forget(self) -> None:
        """Clear the solver's memory of all vehicles beside pose and velocity."""
        state = self._state[self._index]
        rows = np.arange(len(state))
        parked = np.zeros_like(state)
        parked[:, :, :3] = state[:, :, :3]
        parked[:, :, 1] += _PARK
        self._write(rows, parked, hold=False)
        self._use_iterations(cold=False)
        for block in self._blocks:
            block.space.step(self._dt)
        self._write(rows[~self._fresh], state[~self._fresh], hold=True)
        self._write(rows[self._fresh], state[self._fresh], hold=False)
        self._use_iterations(cold=True)
