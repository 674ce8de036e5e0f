# SPDX-License-Identifier: Apache-2.0
"""Motion of rockets as ROS's standard messages have it: stamped, with twists in the body frame."""
from __future__ import annotations

import time
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node import frames
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.telemetry.gaps import GapCounter
from rocket_sim_node.telemetry.quantities import NO_OUTCOME
from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.samples import Samples
from rocket_sim_node.telemetry.stamps import Stamps
from rocket_sim_node.telemetry.stamps import nanoseconds

F64 = NDArray[np.float64]

_UNIT = 1e-3
"""Tolerance for the length of a quaternion; tf2 refuses others."""
_BURST = 1.0
"""Burst of the rate limiter, in seconds of `max_rate`: messages arrive with many steps."""


@dataclass(frozen=True)
class RocketView:
    """One rocket at one time; SI units, frames of REP 103, numbers exactly as on topic `state`.

    `position` `(3,)`, `orientation` `(4,)` x y z w, `velocity` and `disturbance` `(3,)` are in the
    world frame; `linear`, `angular`, `torque` and `specific_force` `(3,)` in the body frame.
    `specific_force` is what an accelerometer measures, m/s^2: acceleration less gravity, mean over
    the step that led here; None where that step is not known, as at the start of an episode.
    `outcome` is empty before the end. `leg_angle` is `(L,)`, `terrain` `(H,)` and `conditions`
    `(C,)`.
    """

    row: int
    episode: int
    begins: bool
    outcome: str
    position: F64
    orientation: F64
    velocity: F64
    linear: F64
    angular: F64
    torque: F64
    specific_force: F64 | None
    disturbance: F64
    throttle: float
    thrust: float
    lateral_thrust: float
    mass: float
    fuel: float
    leg_angle: F64
    terrain: F64
    conditions: F64


@dataclass(frozen=True)
class Moment:
    """The viewed rockets at one stamp, ns of simulated time."""

    stamp: int
    rockets: tuple[RocketView, ...]


class MotionViews:
    """Turns samples of a simulator into moments, each with a later stamp than the one before.

    A step that was published already is left out. When more steps arrive than `max_rate` allows,
    some are left out, evenly; starts and ends of episodes never are.
    """

    def __init__(
        self, rows: Sequence[int], max_rate: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start without a world.

        :param rows: of the viewed rockets.
        :param max_rate: moments per second of wall clock; 0: no limit.
        """
        self._rows = tuple(dict.fromkeys(rows))
        self._rate = max_rate
        self._clock = clock
        self._allowance, self._counted = max_rate * _BURST, clock()
        self._stamps = Stamps()
        self._gaps = GapCounter()
        self._newest: tuple[int, int] | None = None
        self._before: dict[int, tuple[int, int, F64]] = {}
        self.world: WorldInfo | None = None
        """The world that samples are of; set it before the first ones are added."""
        self.shown = 0
        """Moments returned so far."""
        self.skipped = 0
        """Moments left out because of `max_rate`."""

    @property
    def missed(self) -> int:
        """Steps not received; a simulator that knows no subscriber does not publish them."""
        return self._gaps.missed

    def add(self, session: int, samples: Samples, stamp: int | None = None) -> list[Moment]:
        """Return the moments of samples, in the order in which they were taken.

        :param stamp: ns, the simulator's own stamp of the newest sample; None: it is not known.
        :raises ValueError: when there is no world yet, or a value that no simulator sends.
        """
        if self.world is None:
            raise ValueError('arrived before the description of the world on topic world')
        lengths = np.linalg.norm(samples.values[:, FIELDS['orientation']], axis=1)
        if (np.abs(lengths - 1.0) > _UNIT).any():
            wrong = float(lengths[np.argmax(np.abs(lengths - 1.0))])
            raise ValueError(f'orientation: a quaternion of length {wrong:g}, expected 1')
        names = self.world.condition_names
        if names and samples.layout.conditions != len(names):
            raise ValueError(
                f'conditions: {samples.layout.conditions} values a sample, expected {len(names)}')
        if self._newest is not None and self._newest[0] == session:
            samples = samples.take(samples.step > self._newest[1])
        if not len(samples.step):
            return []
        if (np.diff(samples.step) < 0).any():
            raise ValueError('step: not in ascending order')
        first, last = int(samples.step[0]), int(samples.step[-1])
        first_stamp = None if stamp is None else max(
            stamp - nanoseconds(last - first, self.world.dt), 0)
        self._stamps.check(session, first, last, self.world.dt, first_stamp)
        self._gaps.note(session, first, last)
        if self._newest is None or self._newest[0] != session:
            self._before.clear()
        self._newest = session, last
        self._stamps.of(session, first, self.world.dt, first_stamp)
        samples = samples.take(np.isin(samples.row, self._rows))
        if not len(samples.step):
            return []
        return list(self._moments(session, samples, self.world))

    def _moments(
        self, session: int, samples: Samples, world: WorldInfo,
    ) -> Iterator[Moment]:
        begins = _begins(samples)
        views = self._views(samples, world, begins)
        steps, rows = samples.step.tolist(), samples.row.tolist()
        groups: list[list[int]] = []
        seen: set[int] = set()
        for index, (step, row) in enumerate(zip(steps, rows, strict=True)):
            if not groups or steps[groups[-1][0]] != step or row in seen:
                groups.append([])
                seen.clear()
            groups[-1].append(index)
            seen.add(row)
        ends = ((samples.outcome != NO_OUTCOME) | begins).tolist()
        kept = self._allowed([any(ends[index] for index in group) for group in groups])
        for k, group in enumerate(groups):
            # Stamps of what is left out are given as well, so that they do not depend on it.
            step = steps[group[0]]
            again = k > 0 and steps[groups[k - 1][0]] == step
            stamp = self._stamps.next() if again else self._stamps.of(session, step, world.dt)
            if kept[k]:
                self.shown += 1
                yield Moment(stamp, tuple(views(index) for index in group))
            else:
                self.skipped += 1

    def _allowed(self, needed: Sequence[bool]) -> list[bool]:
        """Return which moments are shown."""
        count = len(needed)
        if self._rate <= 0.0:
            return [True] * count
        now = self._clock()
        self._allowance = min(
            self._rate * _BURST, self._allowance + self._rate * (now - self._counted))
        self._counted = now
        room = min(int(self._allowance), count)
        kept = list(needed)
        for k in range(room):
            kept[(2 * k + 1) * count // (2 * room)] = True
        self._allowance = max(self._allowance - sum(kept), 0.0)
        return kept

    def _views(
        self, samples: Samples, world: WorldInfo, begins: NDArray[np.bool_],
    ) -> Callable[[int], RocketView]:
        """Return a function that gives the view of the sample at an index."""
        def of(name: str) -> F64:
            return samples.values[:, samples.layout.place(name)]

        orientation, velocity = of('orientation'), of('linear_velocity')
        linear = frames.to_body(orientation, velocity)
        angular = frames.to_body(orientation, of('angular_velocity'))
        torque = frames.to_body(orientation, of('torque'))
        force = self._specific_force(samples, velocity, orientation, world)
        position, disturbance = of('position'), of('disturbance')
        legs, terrain, drawn = of('leg_angle'), of('terrain'), of('conditions')
        scalars = {
            name: of(name)[:, 0].tolist()
            for name in ('throttle', 'thrust', 'lateral_thrust', 'mass', 'fuel')}

        def view(k: int) -> RocketView:
            return RocketView(
                int(samples.row[k]), int(samples.episode[k]), bool(begins[k]),
                _name(int(samples.outcome[k]), world.outcomes), position[k], orientation[k],
                velocity[k], linear[k], angular[k], torque[k],
                None if np.isnan(force[k, 0]) else force[k], disturbance[k],
                leg_angle=legs[k], terrain=terrain[k], conditions=drawn[k],
                **{name: values[k] for name, values in scalars.items()})

        return view

    def _specific_force(
        self, samples: Samples, velocity: F64, orientation: F64, world: WorldInfo,
    ) -> F64:
        """Return the specific force `(S, 3)` in the body frame, m/s^2; NaN where not known."""
        change = np.full_like(velocity, np.nan)
        for row in np.unique(samples.row).tolist():
            index = np.flatnonzero(samples.row == row)
            step, episode = samples.step[index], samples.episode[index]
            before = self._before.get(row, (-2, -1, np.zeros(3)))
            past = np.concatenate((before[2][None], velocity[index[:-1]]))
            follows = (step - np.concatenate(([before[0]], step[:-1])) == 1) & (
                episode == np.concatenate(([before[1]], episode[:-1])))
            change[index[follows]] = (velocity[index] - past)[follows]
            self._before[row] = int(step[-1]), int(episode[-1]), velocity[index[-1]]
        gravity = np.full(len(velocity), world.settings.get('gravity', np.nan))
        if 'gravity_factor' in world.condition_names:
            column = world.condition_names.index('gravity_factor')
            gravity *= samples.values[:, samples.layout.place('conditions')][:, column]
        felt = change / world.dt
        felt[:, 2] += gravity
        felt[np.isnan(felt).any(axis=1)] = np.nan
        return frames.to_body(orientation, felt)


def _begins(samples: Samples) -> NDArray[np.bool_]:
    """Return which samples are starts of episodes."""
    begins: NDArray[np.bool_] = samples.values[:, samples.layout.place('time')][:, 0] == 0.0
    return begins


def _name(outcome: int, names: tuple[str, ...]) -> str:
    """Return the name of an outcome, empty before the end."""
    if outcome == NO_OUTCOME:
        return ''
    return names[outcome] if outcome < len(names) else f'outcome {outcome}'
