# SPDX-License-Identifier: Apache-2.0
"""What is flown while the clock goes: the last order, until it is too old."""
from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from rocket_sim_node.wire.node.diagnostics import DiagnosticsPublisher
from rocket_sim_node.wire.server.control import NOBODY
from rocket_sim_node.wire.server.control import ControlLease

EVENTS = 'repeated actions', 'clipped actions', 'engine cuts', 'late steps'
"""that are counted in real time only"""
_STEPS = 2.5
"""that an order is flown at least"""


class RealTime:
    """The order that holds, and the watchdog that cuts the engine. By the clock of the lease."""

    def __init__(
        self, period: float, timeout: float, idle: NDArray[Any], lease: ControlLease,
        health: DiagnosticsPublisher,
    ) -> None:
        """Begin without an order.

        :param period: s of the clock from one step to the next.
        :param timeout: s without a new order after which the engine is cut, 2.5 steps at least.
        :param idle: action that is flown without an order.
        :raises ValueError: when another agent could take over before the engine is cut.
        """
        # In slow motion an order is a step old when the next can come; one may be missed.
        self._patience = max(timeout, _STEPS * period)
        if lease.seconds < self._patience:
            raise ValueError(
                f'agent_lease: got {lease.seconds:g} s, expected action_timeout, and {_STEPS:g} '
                f'steps, {self._patience:g} s, or more: a second agent would take over in flight')
        self._period, self._idle, self._lease, self._health = period, idle, lease, health
        self._ticked = lease.now()
        self.begin()

    def begin(self) -> None:
        """Forget the order: a new session begins, or the agent lets go."""
        self._order: NDArray[Any] | None = None
        self._ordered, self._cut = self._lease.now(), False
        self.step = -1
        """that the order answers; an older one comes late, another one for it was sent again"""

    def follow(self, order: NDArray[Any], step: int) -> None:
        """Fly by a new order from the next step on."""
        self._health.clear('actions are back: they are flown again')
        self._order, self.step = order, step
        self._ordered, self._cut = self._lease.now(), False

    def due(self) -> NDArray[Any] | None:
        """Return the action of the step that is due: the order, or idle when that is too old.

        None while nobody has control, or who has it fell silent for as long as the lease: there
        is no flight then.
        """
        now = self._lease.now()
        late, self._ticked = now - self._ticked > 2 * self._period, now
        if not self._cut and self._lease.owner != NOBODY and (
                now - self._ordered > self._patience):
            self._order, self._cut = None, True
            self._health.alarm(
                'engine cuts', f'action: none for {self._patience:g} s: engine cut')
        if self._order is None and self._lease.vacant:
            return None
        if late:
            self._health.count('late steps')
        return self._idle if self._order is None else self._order
