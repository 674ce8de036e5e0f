# SPDX-License-Identifier: Apache-2.0
"""Interfaces and data types of worlds, in this process or on a remote simulator."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import fields
from dataclasses import replace
from typing import Any
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.telemetry.capture import Telemetry

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class WorldSpec:
    """The shape of a world: all that is needed to build a policy and to exchange messages.

    Continuous actions are `(N, A)` float32 within `action_low` and `action_high`; discrete ones
    `(N,)` integers from 0 to `action_count` - 1. `action_idle` is applied when no agent is in
    control: engine off, no torque (for a discrete world, one number). `condition_names` are the
    conditions drawn for each episode, the columns of `Telemetry.conditions`.
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
        """Return the shape of this world after a reset with these settings."""
        return replace(self, settings={**self.settings, **settings})

    @property
    def observation_size(self) -> int:
        """D, number of entries of an observation."""
        return len(self.observation_names)

    @property
    def action_size(self) -> int:
        """A, number of entries of an action (1 when discrete)."""
        return len(self.action_names) if self.continuous else 1


@dataclass(frozen=True)
class Episodes:
    """Episodes that ended at a step, one entry each; all arrays `(K,)`.

    Speed (m/s), tilt (rad) and distance (m, horizontally from the pad) are those of the last
    step, which for a touchdown of `rocket` is the first step at or below touchdown height. In
    `rocket_planar`, where the rocket may stand for a while, a touchdown's speed and tilt are
    those at first contact.

    `fuel_used` and `fuel_left` are kg. `hover_time` (s) is the time with the engine on, above
    touchdown height and slower than 2 m/s at the beginning of a step; `ignitions` counts how
    often the engine went from off to on; `control_effort` is the mean over the steps of the sum
    of the throttle's change (0 to 1) and the absolute values of both RCS commands, as commanded.
    `lunar_lander` models none of these: all five are 0.
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
        """Return the episodes of several steps joined in order."""
        parts = parts or [NO_EPISODES]
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))

    def take(self, index: NDArray[Any] | slice) -> Episodes:
        """Return the selected entries."""
        return Episodes(*(getattr(self, f.name)[index] for f in fields(self)))


_I64 = np.zeros(0, np.int64)
_F64 = np.zeros(0)
NO_EPISODES = Episodes(
    _I64, _I64, _F64, _I64, np.zeros(0, np.uint8), _F64, _F64, _F64, _F64,
    _F64, _F64, _I64, _F64,
)


class VectorEnv(Protocol):
    """N rockets stepped as one batch: a world in this process, or a client of a simulator.

    `step` returns `(observation, reward, terminated, truncated, info)`: `(N, D)` float32, `(N,)`
    float32, two `(N,)` bool. Rockets that finish begin their next episode in the same step, so
    the observation is the new episode's first. `info` has

    - `final_rows` `(K,)`: the rows that finished;
    - `final_observation` `(K, D)`: the last observation of each ended episode;
    - `episodes`: an :class:`Episodes` with one entry for each.
    """

    @property
    def spec(self) -> WorldSpec:
        """The shape of the world."""
        ...

    def reset(self, seed: int | None = None, **settings: Any) -> F32:
        """Start new episodes and return the first observation `(N, D)`.

        :param seed: seed of the random streams; None begins the next episodes of the current seed.
        :param settings: curriculum settings and, in worlds of rockets, conditions as
            `conditions.flatten` takes them. They override the settings of the world's creation
            until the next reset.
        :raises ValueError: for an unknown setting or one out of range; nothing changes.
        """
        ...

    def step(self, action: NDArray[Any]) -> tuple[F32, F32, Bools, Bools, dict[str, Any]]:
        """Advance all rockets by one step.

        :raises ValueError: for actions of the wrong shape or type, or that are not finite;
            nothing changes.
        """
        ...

    def snapshot(self) -> bytes:
        """Return the exact state of all rockets, for `restore`."""
        ...

    def restore(self, state: bytes) -> F32:
        """Restore all rockets from a snapshot and return their observation `(N, D)`.

        :raises ValueError: when it is damaged or of another world or size; nothing changes.
        """
        ...


class SimulatedWorld(VectorEnv, Protocol):
    """A world in this process that also exposes its full state; served by a simulator."""

    @property
    def flown_settings(self) -> dict[str, float]:
        """The settings of `spec` with those that the last reset or restore gave in their place."""
        ...

    def observe(self) -> F32:
        """Return the observation `(N, D)` of the current state."""
        ...

    def step_checked(
        self, command: NDArray[Any],
    ) -> tuple[F32, F32, Bools, Bools, dict[str, Any]]:
        """Advance all rockets by one step, as `step` does, by actions that are checked already.

        :param command: from `actions.checked_action`.
        """
        ...

    def capture(self, rows: NDArray[np.integer] | slice) -> F64:
        """Return a copy of the physical state of the selected rockets, `(K, S)`, a row a quantity.

        Captures of several steps can be concatenated; `telemetry_of` decodes them. It must be
        cheap, as it is called in each step, and is cheaper with a slice.
        """
        ...

    @property
    def captured_ends(self) -> F64:
        """The final states, `(K, S)`, of the rockets that finished at the last step."""
        ...

    def telemetry_of(self, captured: F64) -> Telemetry:
        """Return the telemetry that a capture `(K, S)` holds."""
        ...

    def telemetry(self, rows: NDArray[np.integer] | slice) -> Telemetry:
        """Return the physical state of the selected rockets, S of them."""
        ...

    @property
    def finished(self) -> Telemetry:
        """Final states of the rockets that finished at the last step, with their outcomes."""
        ...
