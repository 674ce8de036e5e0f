# SPDX-License-Identifier: Apache-2.0
"""Real-time mode: hold the last action, and cut the engine when it is too old."""
from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from rocket_sim_node.wire.node.diagnostics import DiagnosticsPublisher
from rocket_sim_node.wire.server.control import NOBODY
from rocket_sim_node.wire.server.control import ControlLease

EVENTS = 'repeated actions', 'clipped actions', 'engine cuts', 'late steps'
"""Events counted in real-time mode only."""
_STEPS = 2.5
"""Minimum number of steps that an action is held."""


class RealTime:
    """The held action and its watchdog, which cuts the engine; uses the lease's clock."""

    def __init__(
        self, period: float, timeout: float, idle: NDArray[Any], lease: ControlLease,
        health: DiagnosticsPublisher,
    ) -> None:
        """Start without an action.

        :param period: seconds of the clock from one step to the next.
        :param timeout: seconds without a new action before the engine is cut, at least 2.5 steps.
        :param idle: action applied while there is no other.
        :raises ValueError: when another agent could take over before the engine is cut.
        """
        # In slow motion, an action is one step old when the next can arrive; one may be lost.
        self._patience = max(timeout, _STEPS * period)
        if lease.seconds < self._patience:
            raise ValueError(
                f'agent_lease: got {lease.seconds:g} s, expected at least action_timeout and '
                f'{_STEPS:g} steps, {self._patience:g} s: otherwise a second agent could take '
                'over in flight')
        self._period, self._idle, self._lease, self._health = period, idle, lease, health
        self._ticked = lease.now()
        self.begin()

    def begin(self) -> None:
        """Forget the action, and pause: a new session begins, or the agent releases control."""
        self._order: NDArray[Any] | None = None
        self._ordered, self._cut = self._lease.now(), False
        self.playing = False
        """Whether the world goes on without an agent, by idle actions."""
        self.step = -1
        """Step that the held action answers; actions for it or an earlier step are ignored."""

    def follow(self, order: NDArray[Any], step: int) -> None:
        """Hold a new action from the next step on."""
        self._health.clear('actions arrive again and are followed')
        self._order, self.step = order, step
        self._ordered, self._cut = self._lease.now(), False

    def due(self) -> NDArray[Any] | None:
        """Return the action of the step that is due: the held one, or idle if it is too old.

        Returns None, so that the world is not stepped, without an agent in control or once its
        lease has expired, unless it is `playing`.
        """
        now = self._lease.now()
        late, self._ticked = now - self._ticked > 2 * self._period, now
        if not self._cut and self._lease.owner != NOBODY and (
                now - self._ordered > self._patience):
            self._order, self._cut = None, True
            self._health.alarm(
                'engine cuts', f'action: none for {self._patience:g} s: engine cut')
        if self._order is None and self._lease.vacant and not self.playing:
            return None
        if late:
            self._health.count('late steps')
        return self._idle if self._order is None else self._order
