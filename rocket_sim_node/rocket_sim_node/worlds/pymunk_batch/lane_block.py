# SPDX-License-Identifier: Apache-2.0
"""One pymunk Space with a block of vehicles side by side, each above its own ground."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple
from typing import Protocol

import pymunk
from pymunk import batch

from rocket_sim_node.worlds.base import F64

LANES = 32
"""Vehicles per Space: with fewer, call overhead dominates; with more, cache misses do."""
_CELLS = 40
"""Cells of the spatial hash per lane."""
_SWEEP_AFTER = 256
"""Number of ground changes after which the cells are cleaned up."""
_NOTHING = pymunk.ShapeFilter(categories=0, mask=0)

STATE = (
    batch.BodyFields.POSITION | batch.BodyFields.ANGLE | batch.BodyFields.VELOCITY
    | batch.BodyFields.ANGULAR_VELOCITY)
PUSH = batch.BodyFields.FORCE | batch.BodyFields.TORQUE
TOUCH = (
    batch.ArbiterFields.BODY_A_ID | batch.ArbiterFields.BODY_B_ID
    | batch.ArbiterFields.TOTAL_IMPULSE | batch.ArbiterFields.POINT_A_1)


class Parts(NamedTuple):
    """Bodies, shapes and joints of one vehicle; each body's origin is its centre of gravity."""

    bodies: Sequence[pymunk.Body]
    shapes: Sequence[pymunk.Shape]
    joints: Sequence[pymunk.Constraint] = ()


class Design(Protocol):
    """Builder of a vehicle and its ground."""

    @property
    def bodies(self) -> int:
        """B, bodies of a vehicle."""
        ...

    @property
    def lane_width(self) -> float:
        """Distance between the origins of neighbouring vehicles, m, so that they never meet."""
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

        If one shape serves all lanes, the first lane, at 0, returns it and the others return none.
        """
        ...


@dataclass(frozen=True)
class Solver:
    """Parameters of the solver for contacts and joints."""

    iterations: int
    """Of a usual step, which starts from the impulses of the one before."""
    slop: float
    """m of penetration that is not corrected."""
    bias: float
    """Part of a penetration that remains after 1 s."""
    cold_iterations: int = 500
    """In the step after the impulses were cleared: with as few as usual, a vehicle at rest jumps
    and is no longer at rest."""


class LaneBlock:
    """A Space and its vehicles; reads and writes whole arrays of body states.

    `state` `(L x B + 1, 6)` and `push` `(L x B + 1, 3)` are what `set_state` and `set_push` write:
    x, y, angle, their rates; force along x and y, torque. The last row is that of the Space's
    static body, which a batch read or write includes.
    """

    def __init__(
        self, design: Design, lanes: int, gravity: float, solver: Solver, state: F64, push: F64,
    ) -> None:
        """Create the vehicles; `state` and `push` are shared with the caller."""
        self.space = space = pymunk.Space()
        space.gravity = (0.0, -gravity)
        space.iterations = solver.iterations
        space.collision_slop = solver.slop
        space.collision_bias = solver.bias
        # Ended contacts are dropped at once: a batch read returns those of the last step only.
        space.collision_persistence = 1
        # A spatial hash, not the default tree, in which the order of solving a vehicle's contacts
        # depends on its neighbours.
        space.use_spatial_hash(design.cell, _CELLS * lanes)
        # All vehicles before all ground: moving shapes are then numbered from 0, and their
        # contacts are solved in the order of their numbers.
        self.vehicles = [design.vehicle() for _ in range(lanes)]
        for vehicle in self.vehicles:
            space.add(*vehicle.bodies, *vehicle.shapes, *vehicle.joints)
        self.grounds = [
            design.ground(space.static_body, lane * design.lane_width) for lane in range(lanes)]
        for ground in self.grounds:
            space.add(*ground)
        self._solver = solver
        self._limits = [[joint.max_force for joint in v.joints] for v in self.vehicles]
        self._moved = 0
        self._field = self.grounds[0][0].bb
        self.state, self.push = state, push
        self._state_buffer, self._push_buffer = batch.Buffer(), batch.Buffer()
        self._state_buffer.set_float_buf(state)
        self._push_buffer.set_float_buf(push)

    def set_state(self) -> None:
        """Set the poses and velocities of all bodies from `state`."""
        batch.set_space_bodies(self.space, STATE, self._state_buffer)

    def set_push(self) -> None:
        """Set the forces of all bodies from `push`, for one step."""
        batch.set_space_bodies(self.space, PUSH, self._push_buffer)

    def use_iterations(self, cold: bool) -> None:
        """Use the iterations of the step after the memory was cleared, or those of all others."""
        self.space.iterations = (
            self._solver.cold_iterations if cold else self._solver.iterations)

    def hold(self, lane: int, on: bool) -> None:
        """Switch the joints of a vehicle on or off; a step without them clears their memory."""
        for joint, limit in zip(self.vehicles[lane].joints, self._limits[lane], strict=True):
            joint.max_force = limit if on else 0.0

    def reindex(self, moved: Sequence[pymunk.Shape]) -> None:
        """Update the index after ground of a lane has moved; in the same order for every lane.

        The hash's cells keep entries of old positions until they are queried, and some never are.
        So all cells are queried from time to time.
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
