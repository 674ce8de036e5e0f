# SPDX-License-Identifier: Apache-2.0
"""Calls of a stopped simulator's services are repeated, and executed once."""
from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
from rocket_msgs import srv
from support.processes import Process
from support.processes import Processes
from support.training.faults import Moments
from support.training.rollouts import assert_same
from support.training.training_runs import make_world
from support.training.training_runs import simulator

from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.client.service_call import ServiceCall
from rocket_sim_node.wire.node import waiting
from rocket_sim_node.wire.node.waiting import WireTimeout
from rocket_sim_node.worlds import EnvironmentRestarted
from rocket_sim_node.worlds.jobs import Reset

N = 8
ROUNDS, NIGHTLY_ROUNDS = 2, 50
REPEATED = (0.25, 0.75, 1.75)
"""s after which a call is made anew for the first time, the second, the third, see wire.client"""
MakeClient = Callable[..., Client]

pytestmark = pytest.mark.timeout(900)


@contextmanager
def stopped(process: Process, seconds: float) -> Iterator[None]:
    """Stop a process for so long; the block ends after the process has continued."""
    process.signal(signal.SIGSTOP)
    timer = threading.Timer(seconds, process.signal, [signal.SIGCONT])
    timer.start()
    try:
        yield
    finally:
        timer.join()


def actions(moments: Moments, steps: int = 20) -> np.ndarray:
    """Return random actions."""
    return np.random.default_rng(moments.random.getrandbits(32)).uniform(
        -1, 1, (steps, N, 3)).astype(np.float32)


def test_repeated_calls_are_executed_once(
        processes: Processes, make_client: MakeClient, nightly: bool) -> None:
    node, client, moments = simulator(processes), make_client(), Moments()
    world = make_world()
    client.reset(0)
    world.reset(0)
    for number in range(NIGHTLY_ROUNDS if nightly else ROUNDS):
        # Also at the very moment at which the call is repeated.
        seconds = moments.random.choice([
            moments.random.uniform(0.0, 3.0),
            moments.random.gauss(moments.random.choice(REPEATED), 0.01)])
        what = moments.random.choice(['reset', 'restore', 'snapshot'])
        state = client.snapshot()
        assert state == world.snapshot()
        for action in actions(moments):
            assert_same(client.step(action), world.step(action))
        with stopped(node, seconds):
            if what == 'reset':
                np.testing.assert_array_equal(client.reset(number), world.reset(number))
            elif what == 'restore':
                np.testing.assert_array_equal(client.restore(state), world.restore(state))
            else:
                assert client.snapshot() == world.snapshot()
        for action in actions(moments):
            assert_same(client.step(action), world.step(action))


def test_an_abandoned_call_does_not_disturb_the_next_flight(
        processes: Processes, make_client: MakeClient, nightly: bool) -> None:
    node, client, moments = simulator(processes), make_client(), Moments()
    world = make_world()
    client.reset(0)
    state = client.snapshot()
    for number in range(NIGHTLY_ROUNDS if nightly else ROUNDS):
        with stopped(node, moments.random.uniform(0.3, 1.0)):
            client.connection.ask(Reset(number, {}))
            client.connection.poll()
            client.waiter.until(lambda: False, moments.random.uniform(0.0, 0.2))
            client.connection.drop()
            for _ in range(3):
                try:
                    client.restore(state)
                    world.restore(state)
                    # The late reset may take the session away; it is noticed, and flown again.
                    for action in actions(moments):
                        assert_same(client.step(action), world.step(action))
                    break
                except EnvironmentRestarted:
                    continue
            else:
                pytest.fail('restored three times and not flown')


class Dying:
    """A service of a simulator that is busy for some calls, and then dead."""

    srv_name = '/simulator/reset'

    def __init__(self, busy: int) -> None:
        self._busy, self.calls, self.settled = busy, 0, 0
        self._answers: list[tuple[int, srv.Reset.Response]] = []

    def service_is_ready(self) -> bool:
        """Return True, as discovery does until the lease of a dead process ends."""
        return True

    def send(self, request: srv.Reset.Request) -> int:
        """Answer that another agent flies it, or nothing."""
        self.calls += 1
        if self.calls <= self._busy:
            self._answers.append(
                (self.calls, srv.Reset.Response(code=srv.Reset.Response.BUSY)))
        return self.calls

    def take(self) -> tuple[int, srv.Reset.Response] | None:
        """Return the next answer, behind the number of its request."""
        return self._answers.pop() if self._answers else None


def test_a_busy_simulator_that_dies_is_a_timeout_after_patience(
        processes: Processes, make_client: MakeClient) -> None:
    connection = make_client(patience=4.0).connection
    service = connection._clients['reset'] = Dying(busy=4)  # type: ignore[assignment]
    connection.ask(Reset(0))
    began = time.monotonic()
    with pytest.raises(WireTimeout):
        while time.monotonic() < began + 20.0:
            connection.poll()
            time.sleep(0.01)
    assert 4.0 < time.monotonic() - began < 15.0  # patience begins anew with the last answer
    assert service.calls >= 4 + len(REPEATED)


def test_logging_a_slow_answer_does_not_repeat_the_call(
        make_client: MakeClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """A call is repeated after twice the time, not each time that the wait is logged."""
    now = 0.0
    monkeypatch.setattr(waiting, 'time', SimpleNamespace(monotonic=lambda: now))
    service = Dying(busy=0)
    call = ServiceCall(make_client().node, service, None, 60.0, '/world', now)  # type: ignore[arg-type]
    made = []
    while now < 50.0:
        call.poll(now)
        if len(made) < service.calls:
            made.append(now)
        now += 0.01
    assert np.diff(made) == pytest.approx(
        [0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 10.0, 10.0, 10.0], abs=0.03)


def test_invalid_service_arguments_are_refused_as_in_process(
        processes: Processes, make_client: MakeClient) -> None:
    """The middleware would end the process otherwise."""
    simulator(processes)
    client, world = make_client(), make_world()
    for seed in (np.int64(5), np.uint8(7)):
        np.testing.assert_array_equal(client.reset(seed), world.reset(seed))
    for bad in (-1, 1.5, 2**63, '5'):
        for reset in (client.reset, world.reset):
            with pytest.raises(ValueError, match=r'seed: got .* expected'):
                reset(bad)
    still = [[-1.0, 0.0, 0.0]] * N
    assert_same(client.step(still), world.step(still))  # type: ignore[arg-type]
    with pytest.raises(TypeError, match='got list, expected Reset, Restore, Snapshot, Act'):
        client.connection.ask(still)  # type: ignore[arg-type]
    assert client.snapshot() == world.snapshot()
