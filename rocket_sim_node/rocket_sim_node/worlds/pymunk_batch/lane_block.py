# SPDX-License-Identifier: Apache-2.0
"""One pymunk Space with a block of vehicles side by side, above ground that is theirs."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple
from typing import Protocol

import pymunk
from pymunk import batch

from rocket_sim_node.worlds.base import F64

LANES = 32
"""vehicles in one Space: with fewer the calls cost more, with more the cache misses do"""
_CELLS = 40
"""cells of the spatial hash for each lane"""
_SWEEP_AFTER = 256
"""lanes whose ground has moved, after which the cells are swept"""
_NOTHING = pymunk.ShapeFilter(categories=0, mask=0)

STATE = (
    batch.BodyFields.POSITION | batch.BodyFields.ANGLE | batch.BodyFields.VELOCITY
    | batch.BodyFields.ANGULAR_VELOCITY)
PUSH = batch.BodyFields.FORCE | batch.BodyFields.TORQUE
TOUCH = (
    batch.ArbiterFields.BODY_A_ID | batch.ArbiterFields.BODY_B_ID
    | batch.ArbiterFields.TOTAL_IMPULSE | batch.ArbiterFields.POINT_A_1)


class Parts(NamedTuple):
    """What one vehicle is made of; the bodies' origins are their centres of gravity."""

    bodies: Sequence[pymunk.Body]
    shapes: Sequence[pymunk.Shape]
    joints: Sequence[pymunk.Constraint] = ()


class Design(Protocol):
    """How to build a vehicle and its ground."""

    @property
    def bodies(self) -> int:
        """B, bodies of a vehicle."""
        ...

    @property
    def lane_width(self) -> float:
        """Distance from one vehicle's origin to the next, m: so large that they never meet."""
        ...

    @property
    def cell(self) -> float:
        """Edge of a cell of the spatial hash, m: about the size of the larger shapes."""
        ...

    def vehicle(self) -> Parts:
        """Return new parts."""
        ...

    def ground(self, body: pymunk.Body, origin: float) -> Sequence[pymunk.Shape]:
        """Return new shapes of ground for the lane at x = `origin`, on a static body.

        Where one shape serves all lanes, the first lane, at 0, brings it and the others none.
        """
        ...


@dataclass(frozen=True)
class Solver:
    """How contacts and joints are solved."""

    iterations: int
    slop: float
    """m of penetration that is left alone"""
    bias: float
    """part of a penetration that is left after 1 s"""


class LaneBlock:
    """A Space and its vehicles; reads and writes whole arrays of body states.

    `state` `(L x B + 1, 6)` and `push` `(L x B + 1, 3)` are what `set_state` and `set_push` write:
    x, y, angle, their rates; force along x and y, torque. The last row is that of the Space's
    static body, which a batch read or write includes.
    """

    def __init__(
        self, design: Design, lanes: int, gravity: float, solver: Solver, state: F64, push: F64,
    ) -> None:
        """Build the vehicles, and borrow the arrays."""
        self.space = space = pymunk.Space()
        space.gravity = (0.0, -gravity)
        space.iterations = solver.iterations
        space.collision_slop = solver.slop
        space.collision_bias = solver.bias
        # Contacts that end are forgotten at once: a batch read has those of the last step only.
        space.collision_persistence = 1
        # Not the default, a tree: there, the order in which a vehicle's contacts are solved
        # depends on what its neighbours did.
        space.use_spatial_hash(design.cell, _CELLS * lanes)
        # All vehicles before all ground: shapes that move are then numbered from 0, and their
        # contacts are solved in the order of their numbers.
        self.vehicles = [design.vehicle() for _ in range(lanes)]
        for vehicle in self.vehicles:
            space.add(*vehicle.bodies, *vehicle.shapes, *vehicle.joints)
        self.grounds = [
            design.ground(space.static_body, lane * design.lane_width) for lane in range(lanes)]
        for ground in self.grounds:
            space.add(*ground)
        self._limits = [[joint.max_force for joint in v.joints] for v in self.vehicles]
        self._moved = 0
        self._field = self.grounds[0][0].bb
        self.state, self.push = state, push
        self._state_buffer, self._push_buffer = batch.Buffer(), batch.Buffer()
        self._state_buffer.set_float_buf(state)
        self._push_buffer.set_float_buf(push)

    def set_state(self) -> None:
        """Give all bodies the poses and velocities in `state`."""
        batch.set_space_bodies(self.space, STATE, self._state_buffer)

    def set_push(self) -> None:
        """Give all bodies the forces in `push`, for one step."""
        batch.set_space_bodies(self.space, PUSH, self._push_buffer)

    def hold(self, lane: int, on: bool) -> None:
        """Switch the joints of a vehicle on or off; a step without empties their memory."""
        for joint, limit in zip(self.vehicles[lane].joints, self._limits[lane], strict=True):
            joint.max_force = limit if on else 0.0

    def reindex(self, moved: Sequence[pymunk.Shape]) -> None:
        """Take note that ground of a lane has moved; in the same order for every lane.

        The cells of the hash keep note of where ground was until somebody looks into them, and
        nobody ever looks into some. So all are looked into now and then.
        """
        for shape in moved:
            self.space.reindex_shape(shape)
        self._moved += 1
        if self._moved >= _SWEEP_AFTER:
            self._moved = 0
            box = self._field
            for ground in self.grounds:
                for shape in ground:
                    box = box.merge(shape.bb)
            self._field = box
            self.space.bb_query(box, _NOTHING)
