# SPDX-License-Identifier: Apache-2.0
"""One agent at a time: the lease, on a clock that the test sets."""
from __future__ import annotations

from rocket_sim_node.wire.server.control import NOBODY
from rocket_sim_node.wire.server.control import ControlLease


class Clock:
    """A clock that the test sets."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_one_agent_has_control_until_its_lease_ends() -> None:
    clock = Clock()
    lease = ControlLease(10.0, clock)
    assert lease.owner == NOBODY
    assert not lease.refusal(1)
    lease.take(1)
    clock.now = 9.5
    assert not lease.refusal(1)
    assert 'agent: 2' in lease.refusal(2)
    assert 'heard 9.5 s ago' in lease.refusal(2)
    lease.heard()
    clock.now = 19.25
    assert lease.refusal(2)
    clock.now = 19.5
    assert not lease.refusal(2)


def test_control_is_vacant_without_an_agent_or_after_its_lease() -> None:
    clock = Clock()
    lease = ControlLease(10.0, clock)
    assert lease.vacant
    lease.take(1)
    clock.now = 9.5
    assert not lease.vacant
    clock.now = 10.0
    assert lease.vacant
    lease.heard()  # it was only held up
    assert not lease.vacant
    lease.release(1)
    assert lease.vacant


def test_only_the_owner_can_release_control_and_is_replaced_at_once() -> None:
    lease = ControlLease(10.0, Clock())
    lease.take(1)
    assert not lease.release(2)
    assert lease.refusal(2)
    assert lease.release(1)
    assert not lease.refusal(2)
