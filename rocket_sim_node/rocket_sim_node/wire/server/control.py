# SPDX-License-Identifier: Apache-2.0
"""Lease that gives one agent at a time control of a simulator, until released or expired."""
from __future__ import annotations

import time
from collections.abc import Callable

NOBODY = 0


class ControlLease:
    """The lease of the agent in control.

    An agent takes control by a reset or a restore. It keeps control while it is heard from at
    least every `seconds`; other agents are refused meanwhile. An agent that returns under the same
    identity is the same agent.
    """

    def __init__(self, seconds: float, clock: Callable[[], float] = time.monotonic) -> None:
        """Start without an owner."""
        self.seconds = seconds
        self._clock = clock
        self._heard = 0.0
        self.owner = NOBODY

    def refusal(self, agent: int) -> str:
        """Return why `agent` may not take control now; empty if it may."""
        other = '' if self.owner == agent else self.flown_by()
        return f'agent: {agent}, but {other}' if other else ''

    def flown_by(self, name: str = '') -> str:
        """Return a sentence that says which agent has control; empty if any may take it.

        :param name: of the owner's node; empty if it is not known.
        """
        if self.vacant:
            return ''
        return (
            f'agent {self.owner}{name and f", node {name},"} controls this simulator '
            f'(last heard {self.silent:.1f} s ago; free after {self.seconds:g} s of silence)'
        )

    def stranger(self, agent: int) -> str:
        """Return why actions of `agent` are refused; empty if it has control."""
        if self.owner == NOBODY:
            return f'agent: {agent}, but no agent is in control; call reset first'
        if agent == self.owner:
            return ''
        return f'agent: {agent}, expected {self.owner}, which controls this simulator'

    @property
    def vacant(self) -> bool:
        """Whether any agent may take control: there is no owner, or its lease has expired."""
        return self.owner == NOBODY or self.silent >= self.seconds

    @property
    def silent(self) -> float:
        """Seconds since the owner was heard."""
        return self._clock() - self._heard

    def take(self, agent: int) -> None:
        """Give control to `agent`."""
        self.owner = agent
        self.heard()

    def now(self) -> float:
        """Return the time of the lease's clock, s."""
        return self._clock()

    def heard(self) -> None:
        """Renew the lease."""
        self._heard = self._clock()

    def release(self, agent: int) -> bool:
        """Give up control; return false if `agent` did not have it."""
        if self.stranger(agent):
            return False
        self.owner = NOBODY
        return True
