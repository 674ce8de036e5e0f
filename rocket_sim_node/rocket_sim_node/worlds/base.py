# SPDX-License-Identifier: Apache-2.0
"""What every world is to those who use it, in this process or at the far end of the wire."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import fields
from dataclasses import replace
from typing import Any
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

NO_OUTCOME = 255
"""The outcome of an episode that still goes on."""


@dataclass(frozen=True)
class WorldSpec:
    """The shape of a world: enough to build a policy for it and to speak to it.

    Continuous actions are `(N, A)` float32 within `action_low` and `action_high`; discrete ones
    `(N,)` whole numbers from 0 to `action_count` - 1. `action_idle` is what a rocket flies when
    nobody steers it: engine off, no torque (for a discrete world, one number). `condition_names`
    are those of what is drawn for each episode, the columns of `Telemetry.conditions`.
    """

    name: str
    num_envs: int
    dt: float
    observation_names: tuple[str, ...]
    action_names: tuple[str, ...]
    continuous: bool
    action_low: tuple[float, ...]
    action_high: tuple[float, ...]
    action_idle: tuple[float, ...]
    action_count: int
    outcomes: tuple[str, ...]
    settings: dict[str, float]
    condition_names: tuple[str, ...] = ()

    def after_reset(self, settings: Mapping[str, float]) -> WorldSpec:
        """Return the shape of this world with the settings that a reset puts into force."""
        return replace(self, settings={**self.settings, **settings})

    @property
    def observation_size(self) -> int:
        """D, numbers in an observation."""
        return len(self.observation_names)

    @property
    def action_size(self) -> int:
        """A, numbers in an action (1 when discrete)."""
        return len(self.action_names) if self.continuous else 1


@dataclass(frozen=True)
class Episodes:
    """Episodes that ended at a step, one entry each; all arrays `(K,)`.

    Speed (m/s), tilt (deg) and distance (m, horizontally from the pad) are those of the last
    step, which for a touchdown of `rocket` is the first step at or below touchdown height. In
    `rocket_planar`, where it may stand for a while, speed and tilt of a touchdown are those at
    first contact.

    `fuel_used` and `fuel_left` are kg. `hover_time` (s) is the time with the engine on, above
    touchdown height and slower than 2 m/s at the beginning of a step; `ignitions` counts how
    often the engine went from off to on; `control_effort` is the mean over the steps of the sum
    of the throttle's change (0 to 1) and the absolute values of both RCS commands, as commanded.
    `lunar_lander` has no tanks and none of these: all five are 0 there.
    """

    row: NDArray[np.int64]
    episode: NDArray[np.int64]
    episode_return: F64
    length: NDArray[np.int64]
    outcome: NDArray[np.uint8]
    touchdown_speed: F64
    tilt: F64
    distance: F64
    fuel_used: F64
    fuel_left: F64
    hover_time: F64
    ignitions: NDArray[np.int64]
    control_effort: F64

    def __len__(self) -> int:
        """Return K."""
        return len(self.row)

    @classmethod
    def concatenate(cls, parts: list[Episodes]) -> Episodes:
        """Join the episodes of several steps, in order."""
        parts = parts or [NO_EPISODES]
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))

    def take(self, index: NDArray[Any] | slice) -> Episodes:
        """Return the chosen entries."""
        return Episodes(*(getattr(self, f.name)[index] for f in fields(self)))


_I64 = np.zeros(0, np.int64)
_F64 = np.zeros(0)
NO_EPISODES = Episodes(
    _I64, _I64, _F64, _I64, np.zeros(0, np.uint8), _F64, _F64, _F64, _F64,
    _F64, _F64, _I64, _F64,
)


@dataclass(frozen=True)
class Telemetry:
    """Physical state of S rockets, world frame with y up; see RocketState.msg for the meaning.

    Vectors are `(S, 3)`, the quaternion `(S, 4)` in the order x y z w; `contact` and `leg_angle`
    are `(S, L)`, L = 0 in worlds without legs; `terrain` is `(S, H)`, H = 0 where the ground is
    flat; the rest is `(S,)`. `commanded_throttle`, 0 to 1, is what was asked for at this step;
    `disturbance` m/s^2 is side acceleration plus gust; `conditions` `(S, C)` are the values drawn
    for the episode, in the order of `conditions.DRAWN_NAMES`, C = 0 in worlds without conditions.
    """

    row: NDArray[np.int64]
    episode: NDArray[np.int64]
    time: F64
    position: F64
    orientation: F64
    linear_velocity: F64
    angular_velocity: F64
    mass: F64
    fuel: F64
    throttle: F64
    thrust: F64
    lateral_thrust: F64
    torque: F64
    contact_force: F64
    contact: NDArray[np.bool_]
    leg_angle: F64
    terrain: F64
    reward: F64
    outcome: NDArray[np.uint8]
    commanded_throttle: F64
    disturbance: F64
    conditions: F64

    def take(self, index: NDArray[Any] | slice) -> Telemetry:
        """Return the chosen samples."""
        return Telemetry(*(getattr(self, f.name)[index] for f in fields(self)))


class VectorEnv(Protocol):
    """N rockets stepped as one batch: a world in this process, or a client of a simulator.

    `step` answers `(observation, reward, terminated, truncated, info)`: `(N, D)` float32, `(N,)`
    float32, two `(N,)` bool. Rockets that finish begin their next episode in the same step, so
    that the observation is the new episode's first. `info` has

    - `final_rows` `(K,)`: the rows that finished;
    - `final_observation` `(K, D)`: the last observation of the episode that ended;
    - `episodes`: an :class:`Episodes` with one entry for each.
    """

    @property
    def spec(self) -> WorldSpec:
        """The shape of the world."""
        ...

    def reset(self, seed: int | None = None, **settings: Any) -> F32:
        """Begin new episodes and return the first observation `(N, D)`.

        :param seed: where the random streams start; None begins the next episodes of the seed in
            force.
        :param settings: curriculum settings and, in worlds of rockets, conditions as
            `conditions.flatten` takes them, on top of those the world was made with, until the
            next reset.
        :raises ValueError: for an unknown setting or one out of range; nothing changes.
        """
        ...

    def step(self, action: NDArray[Any]) -> tuple[F32, F32, Bools, Bools, dict[str, Any]]:
        """Advance all rockets by one step.

        :raises ValueError: for actions of the wrong shape or kind, or that are not finite;
            nothing changes.
        """
        ...

    def snapshot(self) -> bytes:
        """Return the exact state of all rockets, to be given to `restore`."""
        ...

    def restore(self, state: bytes) -> F32:
        """Put all rockets back into a snapshot and return their observation `(N, D)`.

        :raises ValueError: when it is damaged or of another world or size; nothing changes.
        """
        ...


class SimulatedWorld(VectorEnv, Protocol):
    """A world in this process, which can also be looked into: what a simulator serves."""

    def observe(self) -> F32:
        """Return the observation `(N, D)` of the present state."""
        ...

    def capture(self, rows: NDArray[np.integer] | slice) -> F64:
        """Return a copy of the physical state of the chosen rockets, `(K, S)`, a row a quantity.

        Which they are is the world's affair, but for the first, which rocket it is. Captures of
        several steps can be put side by side; `telemetry_of` reads them. Cheap, as it is done at
        each step, and cheaper with a slice.
        """
        ...

    @property
    def captured_ends(self) -> F64:
        """The last states, `(K, S)`, of the rockets that finished at the last step."""
        ...

    def telemetry_of(self, captured: F64) -> Telemetry:
        """Return what a capture `(K, S)` says."""
        ...

    def telemetry(self, rows: NDArray[np.integer] | slice) -> Telemetry:
        """Return the physical state of the chosen rockets, S of them."""
        ...

    @property
    def finished(self) -> Telemetry:
        """Last states of the rockets that finished at the last step, with their outcomes."""
        ...
