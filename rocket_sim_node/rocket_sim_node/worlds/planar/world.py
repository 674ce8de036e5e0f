# SPDX-License-Identifier: Apache-2.0
"""World `rocket_planar`: the rocket in the x-y plane, with legs that bounce, slide, tip and stand.

In flight it is identical to world `rocket`: a start in the plane stays in it. A touchdown begins
at first contact and ends at rest: see PlanarContact. Observations and actions are those of
`rocket`, with out-of-plane values 0 (but see below), so that one policy flies both.

A policy trained in one plane alone has never controlled the other axis, and cannot fly `rocket`.
With `spawn_heading`, the axes of the pilot's observations and actions are turned about the
vertical, by another angle in each episode, so that it learns all planes. The simulation itself
stays in the x-y plane.

First contact is found from the geometry, after the step that brings a foot to the ground or below
and before the ground has any effect, as `rocket` finds its touchdown. From then on pymunk moves
the vehicle, with a push equal to the velocity change of a step of flight. (`substeps` refine
flight; contact is solved once a step.)
"""
from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds import random_streams
from rocket_sim_node.worlds import snapshots
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.planar import contact_model
from rocket_sim_node.worlds.planar import vehicle
from rocket_sim_node.worlds.planar.contact_model import PlanarContact
from rocket_sim_node.worlds.planar.vehicle import PlanarSettings
from rocket_sim_node.worlds.rocket import outcome as outcomes
from rocket_sim_node.worlds.rocket import rotation
from rocket_sim_node.worlds.rocket import spawn
from rocket_sim_node.worlds.rocket.actuators import IDLE
from rocket_sim_node.worlds.rocket.dynamics import TURNED
from rocket_sim_node.worlds.rocket.world import RocketWorld

_IN_FLIGHT = -1
_PREFIX = 'contact_'
_OUT_OF_PLANE = {
    'position': slice(2, 3), 'velocity': slice(2, 3), 'spin': slice(0, 2), 'attitude': slice(0, 2)}
_HEADINGS = 2**32
"""Index of an episode's random stream; starts use the first ones."""


class RocketPlanarWorld(RocketWorld):
    """N rockets, each in a vertical plane of its own. A `SimulatedWorld`.

    Out-of-plane entries of `position`, `velocity`, `attitude` and `spin` stay 0.
    """

    name = 'rocket_planar'
    settings_class = PlanarSettings
    settings: PlanarSettings
    reset_settings = (*RocketWorld.reset_settings, 'spawn_heading')
    in_plane = True
    feet = 2

    def __init__(self, num_envs: int = 1, seed: int = 0, **settings: Any) -> None:
        """Create the world and begin the first episodes.

        :raises ValueError: for a setting that is unknown or out of range.
        """
        self._steps_down = np.full(num_envs, _IN_FLIGHT)
        self._contact_speed = np.zeros(num_envs)
        self._contact_tilt = np.zeros(num_envs)
        self._struck = np.zeros(num_envs, np.bool_)
        # Cosine and sine of the angle by which each pilot's axes are turned.
        self._heading = np.tile([[1.0], [0.0]], num_envs)
        super().__init__(num_envs, seed, **settings)
        s = self.settings
        self.contact = PlanarContact(num_envs, s)
        self._corners = np.array([*vehicle.feet(s), *vehicle.hull(s)])
        self._reach = np.hypot(*self._corners.T).max()
        self._most_steps_down = _most_steps_down(s)

    def _begin(self, rows: NDArray[np.integer], first: spawn.Spawn) -> None:
        """Set the given rockets to their initial states."""
        super()._begin(rows, first)
        self._turn_axes(rows)
        touched = rows[self._steps_down[rows] != _IN_FLIGHT]
        if touched.size:
            self.contact.end(touched)
            self._steps_down[touched] = _IN_FLIGHT
            self._struck[touched] = False
            self._contact_speed[touched] = self._contact_tilt[touched] = 0.0

    def _use(self, settings: PlanarSettings, seed: int) -> None:  # type: ignore[override]
        """Apply settings and a seed; episodes must be started or loaded afterwards.

        :raises ValueError: when they make landing or flight impossible.
        """
        rest, most = contact_model.rest_steps(settings), _most_steps_down(settings)
        if rest > most:
            raise ValueError(
                f"setting 'rest_time': got {settings.rest_time}, which takes {rest} steps of "
                f'{settings.dt} s, expected at most the {most} of touchdown_limit, '
                f'{settings.touchdown_limit} s')
        least = _least_spawn_height(settings)
        if settings.spawn_height <= least:
            raise ValueError(
                f"setting 'spawn_height': got {settings.spawn_height}, expected more than "
                f'{least:.3f} m, where foot or hull could touch'
                f"{', as spawn_reach is not 0' if settings.spawn_reach else ''}")
        super()._use(settings, seed)

    # Axes of the pilot

    def _turn_axes(self, rows: NDArray[np.integer]) -> None:
        """Draw the headings of rockets' current episodes."""
        if not self.settings.spawn_heading:
            self._heading[:, rows] = [[1.0], [0.0]]
            return
        streams = rows // self.settings.spawn_copies
        unit = random_streams.uniform(self._seed, streams, self.episode[rows], 1, _HEADINGS)[0]
        angle = np.deg2rad(unit * self.settings.spawn_heading)
        self._heading[:, rows] = np.cos(angle), np.sin(angle)

    def _observe(self, rows: NDArray[np.integer] | slice, up: F64) -> F32:
        """Return the observation `(K, D)` of the selected rockets, in the pilots' axes."""
        observation = super()._observe(rows, up)
        if self.settings.spawn_heading:
            cos, sin = self._heading[:, rows]
            for columns in TURNED:
                vectors = observation[:, columns]
                along, across = vectors[:, 0::3].copy(), vectors[:, 2::3]
                vectors[:, 0::3] = cos[:, None] * along + sin[:, None] * across
                vectors[:, 2::3] = cos[:, None] * across - sin[:, None] * along
        return observation

    # Stepping

    def _advance(self, command: F64) -> None:
        """Integrate one step; in touchdown, the accelerations of flight are applied as a force."""
        s = self.settings
        landing = np.flatnonzero(self._steps_down != _IN_FLIGHT)
        cos, sin = self._heading
        command = command.copy()  # in real time, the simulator holds it for several steps
        command[:, 2] = np.clip(cos * command[:, 2] + sin * command[:, 1], -1.0, 1.0)
        command[:, 1] = 0.0
        if landing.size:
            if s.engine_cutoff:
                command[landing] = IDLE
            before = self._motion(landing)
        super()._advance(command)
        began = self._touch_down()
        if landing.size:
            acceleration = (self._motion(landing) - before) / s.dt
            self._follow(landing, *self.contact.step(landing, acceleration))
            self._steps_down[landing] += 1
        elif began:
            self.contact.step(landing, np.zeros((0, 3)))

    def _motion(self, rows: NDArray[np.int64]) -> F64:
        """Return velocities `(K, 3)` within the plane: m/s, m/s, rad/s."""
        velocity_x, velocity_y = self.velocity[:2, rows]
        return np.stack((velocity_x, velocity_y, self.spin[2, rows]), axis=1)

    def _touch_down(self) -> bool:
        """Start touchdowns of rockets in first contact; return whether there are any."""
        s = self.settings
        low = np.flatnonzero(
            (self.position[1] <= self._reach) & (self._steps_down == _IN_FLIGHT))
        if not low.size:
            return False
        up = rotation.up_vector(self.attitude[:, low])
        height = contact_model.heights(self._corners, self.position[1, low], -up[0], up[1])
        down = (height <= 0.0).any(1)
        if not down.any():
            return False
        rows, up, height = low[down], up[:, down], height[down]
        speed = rotation.norm(self.velocity[:, rows])
        struck = (height[:, 2:] <= 0.0).any(1)
        self._contact_speed[rows] = speed
        self._contact_tilt[rows] = np.rad2deg(np.arctan2(np.abs(up[0]), up[1]))
        self._struck[rows] = struck
        self._steps_down[rows] = 0
        self._touching[rows] = height[:, :2] <= 0.0
        # The others' episodes end at this step.
        stands = (speed < s.landed_speed) & ~struck
        rows, up = rows[stands], up[:, stands]
        if not rows.size:
            return False
        pose = np.stack((*self.position[:2, rows], np.arctan2(-up[0], up[1])), axis=1)
        self.contact.begin(rows, pose, self._motion(rows),
                           self.vehicles.dry_mass[rows] + self.fuel[rows])
        return True

    def _follow(self, rows: NDArray[np.int64], pose: F64, velocity: F64) -> None:
        """Take over poses and velocities, `(K, 3)` each, from the contact model."""
        self.position[:2, rows] = pose[:, :2].T
        self.velocity[:2, rows] = velocity[:, :2].T
        self.spin[2, rows] = velocity[:, 2]
        self.attitude[2, rows] = np.sin(pose[:, 2] / 2)
        self.attitude[3, rows] = np.cos(pose[:, 2] / 2)
        self._struck[rows] = self.contact.hull[rows]
        self._touching[rows] = self.contact.feet[rows]
        self.contact_force[:2, rows] = self.contact.force[rows].T

    # Ends of episodes

    def _ended(self, up_y: F64) -> NDArray[np.int64]:
        """Return the rows whose episode ended at this step, `(K,)`; keep reasons for `_judge`."""
        super()._ended(up_y)
        # Contact, not height, makes a touchdown here; of the flight limits only the edge of the
        # field applies during one.
        self._down[:] = False
        ended = self._tilted | self._late | self._outside
        landing = np.flatnonzero(self._steps_down != _IN_FLIGHT)
        if landing.size:
            self._outside[landing] |= self.contact.lost[landing]
            outside = self._outside[landing]
            self._tilted[landing] = self._late[landing] = False
            self._down[landing] = ~outside & (
                self._struck[landing] | self.contact.resting[landing]
                | (self._contact_speed[landing] >= self.settings.landed_speed)
                | (self._steps_down[landing] >= self._most_steps_down))
            ended[landing] = self._down[landing] | outside
        return np.flatnonzero(ended)

    def _judge(
        self, done: NDArray[np.int64], up: F64,
    ) -> tuple[NDArray[np.uint8], F64, F64, F64]:
        """Return the results of episodes; speed and tilt of a touchdown are at first contact."""
        outcome, speed, tilt, distance = super()._judge(done, up)
        down = self._down[done]
        rows = done[down]
        if rows.size:
            speed[down] = self._contact_speed[rows]
            outcome[down] = outcomes.judge_contact(
                self._struck[rows], self.contact.resting[rows], speed[down], tilt[down],
                distance[down], self.settings)
            tilt[down] = self._contact_tilt[rows]
        return outcome, speed, tilt, distance

    # Snapshots

    def snapshot(self) -> bytes:
        """Return the exact state; clears the contact solver's memory, as `restore` does."""
        self.contact.forget()
        return super().snapshot()

    def _state_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the complete state; most of the arrays are the world's own."""
        return {
            **super()._state_arrays(), 'steps_down': self._steps_down,
            'contact_speed': self._contact_speed, 'contact_tilt': self._contact_tilt,
            **{_PREFIX + name: array for name, array in self.contact.arrays().items()}}

    def _check_state(  # type: ignore[override]
        self, arrays: snapshots.Arrays, settings: PlanarSettings,
    ) -> None:
        """Check for values of a snapshot that no world with these settings can have."""
        super()._check_state(arrays, settings)
        s = settings
        fuel = s.fuel * s.drawn_range('fuel_factor')[1]
        steps_down = arrays['steps_down']
        if (steps_down < _IN_FLIGHT).any():
            raise ValueError(f'snapshot: steps_down has a value below {_IN_FLIGHT}')
        if (steps_down > self._most_steps_down).any():
            raise ValueError(f'snapshot: steps_down has a value above {self._most_steps_down}')
        if (arrays['age'] > self._max_age + 1 + steps_down).any():
            raise ValueError('snapshot: age has a value beyond time_limit')
        if ((steps_down != _IN_FLIGHT) != arrays['contact_present']).any():
            raise ValueError('snapshot: steps_down and contact_present disagree on which vehicles '
                'have touched')
        if (arrays['contact_still'] < 0).any():
            raise ValueError('snapshot: contact_still has a value below 0')
        if (arrays['contact_still'] > np.maximum(steps_down, 0)).any():
            raise ValueError('snapshot: contact_still has a value above steps_down')
        for name, place in _OUT_OF_PLANE.items():
            if arrays[name][place].any():
                raise ValueError(f'snapshot: {name} has a value out of the plane')
        if (arrays['fuel'] > fuel).any():
            raise ValueError(f'snapshot: fuel has a value above {fuel:g} kg')
        # In flight, the value is that of an earlier touchdown, perhaps under other conditions.
        mass, present = arrays['contact_mass'], arrays['contact_present']
        least, most = s.drawn_range('dry_mass_factor')
        lightest, heaviest = s.dry_mass * least, s.dry_mass * most + fuel
        if ((mass <= 0) | (present & ((mass < lightest) | (mass > heaviest)))).any():
            raise ValueError(
                f'snapshot: contact_mass has a value outside {lightest:g} to {heaviest:g} kg')
        if (np.abs(arrays['contact_start_x']) > s.range_limit + s.stance + 1000.0).any():
            raise ValueError('snapshot: contact_start_x has a value outside the field')
        self.contact.check({
            name.removeprefix(_PREFIX): array for name, array in arrays.items()
            if name.startswith(_PREFIX)})

    def _load_state(self, arrays: snapshots.Arrays, ours: snapshots.Arrays) -> None:
        """Copy the arrays of a snapshot into ours."""
        own = self.contact.arrays()
        self.contact.load({name: arrays[_PREFIX + name] for name in own})
        super()._load_state(
            {name: array for name, array in arrays.items()
             if name.removeprefix(_PREFIX) not in own}, ours)
        self._struck[:] = False
        self._turn_axes(self.rows)


def _least_spawn_height(settings: PlanarSettings) -> float:
    """Return the spawn height, m, above which all starts keep foot and hull off the ground."""
    angle = np.deg2rad(spawn.spawn_range(settings).angle)
    widest = min(angle, np.deg2rad(settings.tilt_limit))
    # Denser towards 0: the lowest starts lean least.
    lean = widest * np.linspace(0.0, 1.0, 2001)**2
    corners = np.array([*vehicle.feet(settings), *vehicle.hull(settings)])
    reach = -contact_model.heights(corners, np.zeros_like(lean), np.sin(lean), np.cos(lean)).min(1)
    least = float(reach.max())
    if settings.spawn_reach and widest:
        # A lower start leans less in proportion, but its feet are nearer to the ground as well.
        ground = settings.touchdown_height
        slope = ((reach[1:] - ground) / lean[1:]).max()
        least = max(least, float(ground + angle * slope))
    return least


def _most_steps_down(settings: PlanarSettings) -> int:
    """Return the number of steps from touchdown after which an episode ends."""
    return int(np.floor(settings.touchdown_limit / settings.dt + 1e-9))
