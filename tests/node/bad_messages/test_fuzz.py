# SPDX-License-Identifier: Apache-2.0
"""A running simulator and a running agent under thousands of invalid messages."""
from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rocket_msgs import msg
from rocket_msgs import srv
from scipy import stats
from support.invalid_data.fuzzing import DAMAGES
from support.invalid_data.fuzzing import damaged
from support.invalid_data.rubbish import N
from support.invalid_data.rubbish import Rubbish
from support.processes import Process
from support.processes import Processes
from support.training.rollouts import assert_same

from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.wire.messages.cdr import Codec
from rocket_sim_node.worlds import make

AGENT = 0xC0FFEE
_QUEUE = 4
"""messages that the simulator's reader holds; beyond it the oldest are lost"""
_BURST = _QUEUE - 1
_BURSTS, _PAUSE = 10, 0.0002
"""of a flood between two good actions, and s after each"""
_MADE = 3000


def resident(process: Process) -> float:
    """Return the largest memory of a process and its children, bytes."""
    children = Path(f'/proc/{process.pid}/task/{process.pid}/children').read_text().split()
    return max(1024.0 * int(line.split()[1]) for pid in (process.pid, *children)
               for line in Path(f'/proc/{pid}/status').read_text().splitlines()
               if line.startswith('VmRSS'))


class Fuzzer(Rubbish):
    """A valid client that sends invalid messages between its actions."""

    def __init__(self, process: Process, client: Client, seed: int) -> None:
        super().__init__(client.connection, seed)
        self.process, self.client, self.seed = process, client, seed
        self.world = make('rocket', num_envs=N)
        self.sent = 0
        self.expected: Counter[str] = Counter()
        self.status: Any = None
        self.sizes: list[tuple[int, float]] = []
        client.node.create_subscription(
            DiagnosticArray, '/diagnostics', self._on_diagnostics, qos.EVENTS)
        self._services = {
            name: client.node.create_client(kind, f'simulator/{name}') for name, kind in (
                ('reset', srv.Reset), ('restore', srv.Restore), ('snapshot', srv.Snapshot),
                ('release', srv.Release))}
        client.reset(1)
        self.world.reset(1)
        assert client.waiter.until(lambda: client.node.count_publishers('/diagnostics') > 1, 10.0)
        # A first step, sent until it is answered: from then on nothing gets lost on the way.
        idle = np.zeros((N, 3), np.float32)
        assert_same(client.step(idle), self.world.step(idle))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.status = message.status[0]

    def counts(self) -> dict[str, str]:
        """Return the counters in the simulator's diagnostics."""
        return {item.key: item.value for item in self.status.values} if self.status else {}

    def run(self, count: int, calls: int) -> None:
        """Send invalid messages, as many as the simulator's queue holds, then a good action.

        :param calls: services to call as badly, over the whole run.
        """
        rounds = count // _BURST
        due = set(np.linspace(0, rounds - 1, calls).astype(int).tolist())
        for number in range(rounds):
            for _ in range(_BURST):
                self.send(self.rubbish())
            if number in due:
                self.call_badly()
            self.step()

    def flood(self, handled: int) -> None:
        """Send prepared invalid messages until the simulator has handled so many in all.

        They come about as fast as it can handle them, with a good action now and then.
        """
        made = [self.rubbish() for _ in range(_MADE)]
        last = self.handled
        while self.handled < handled:
            for _ in range(_BURSTS):
                for index in self.rng.integers(_MADE, size=_BURST).tolist():
                    if self._fate(made[index]) != 'flown':  # its step may have come since
                        self.send(made[index])
                time.sleep(_PAUSE)
            self.step()
            if self.handled > last:  # the simulator has reported
                last = self.handled
                self.sizes.append((last, resident(self.process)))

    def send(self, data: bytes) -> None:
        """Publish an invalid message whose outcome is known."""
        self.expected[self._fate(data)] += 1
        self.client.connection._publisher.publish(data)
        self.sent += 1

    def step(self) -> None:
        """Fly a good action, whose answer is right to the bit."""
        action = self.rng.uniform(-1, 1, (N, 3)).astype(np.float32)
        assert_same(self.client.step(action), self.world.step(action))

    @property
    def handled(self) -> int:
        """How many invalid messages the simulator has counted, up to a second ago."""
        return sum(int(self.counts().get(name, 0)) for name in (
            'refused on action', 'repeated answers'))

    def call_badly(self) -> None:
        """Call a service in a way that is refused."""
        rng, connection = self.rng, self.client.connection
        name = str(rng.choice(list(self._services)))
        stranger = int(rng.integers(1, 2**63))
        noise = conversion.to_sequence(np.frombuffer(rng.bytes(200), np.uint8), 'u1')
        mine = bool(rng.integers(2))
        request: Any = {
            'reset': lambda: srv.Reset.Request(
                agent=connection.agent if mine else stranger, seed=-7,
                settings=[msg.Setting(name=rng.bytes(9).decode(errors='replace'),
                                      value=float('nan'))]),
            'restore': lambda: srv.Restore.Request(
                agent=connection.agent if mine else stranger, state=noise),
            'snapshot': lambda: srv.Snapshot.Request(
                agent=connection.agent if mine else stranger, session=stranger),
            'release': lambda: srv.Release.Request(agent=stranger)}[name]()
        future = self._services[name].call_async(request)
        assert self.client.waiter.until(future.done, 10.0)
        answer = future.result()
        assert answer.code != answer.OK
        assert answer.message
        self.expected[f'refused on {name}'] += 1

    def growth(self) -> tuple[float, float, float]:
        """Return bytes of memory a message handled, since the first quarter, and its 95 %."""
        handled, size = np.array(self.sizes[len(self.sizes) // 4:]).T
        fit = stats.linregress(handled, size)
        half = fit.stderr * stats.t.ppf(0.975, len(handled) - 2)
        return fit.slope, fit.slope - half, fit.slope + half


@pytest.fixture
def fuzzer(processes: Processes, make_client: Callable[..., Client], nightly: bool) -> Fuzzer:
    # Not forked: inherited memory that is free would hide a leak.
    process = processes.run_node('rocket_sim_node', 'simulator', num_envs=N)
    seed = time.time_ns() % 2**32 if nightly else 1
    # An action that is sent again would push what is counted out of the simulator's queue.
    return Fuzzer(process, make_client(agent=AGENT, resend_after=2.0), seed)


def test_a_simulator_survives_thousands_of_invalid_messages(fuzzer: Fuzzer, nightly: bool) -> None:
    """Four thousand are counted to the last one; then comes a flood, part of which may be lost.

    It ends when the simulator has handled 20 thousand, or 300 thousand with `--nightly`. Every
    answer to a good action is that of a world in this process, to the bit; in the end the
    simulator is as large as before.
    """
    many = 300_000 if nightly else 20_000
    begun = time.monotonic()
    print(f'seed {fuzzer.seed}')
    fuzzer.run(100_000 if nightly else 4_000, 1000 if nightly else 100)
    expected = dict(fuzzer.expected)
    again = expected.pop('repeated answers')

    def counted() -> bool:
        found = fuzzer.counts()
        return int(found.get('repeated answers', 0)) >= again and all(
            found.get(name) == str(count) for name, count in expected.items())

    assert fuzzer.client.waiter.until(counted, 10.0), [
        (name, count, fuzzer.counts().get(name)) for name, count in expected.items()]
    # The client sent some calls twice, as answers took long; both were answered.
    assert int(fuzzer.counts()['repeated answers']) <= again + fuzzer.client.resent
    assert fuzzer.expected.keys() == {'repeated answers', *(
        f'refused on {name}' for name in ('action', 'reset', 'restore', 'snapshot', 'release'))}
    fuzzer.flood(many)
    slope, low, high = fuzzer.growth()
    lines = fuzzer.process.output().count('refused')
    print(f'{fuzzer.sent} messages, {fuzzer.handled} of them handled, in '
          f'{time.monotonic() - begun:.0f} s, refused as foretold: {dict(fuzzer.expected)}; '
          f'memory {slope:+.2f} bytes a message handled '
          f'(95 %: {low:+.2f} to {high:+.2f}); {lines} lines of log')
    assert fuzzer.handled >= many
    assert fuzzer.client.snapshot() == fuzzer.world.snapshot()
    assert high < 5.0, 'it may grow with each message'
    assert lines < time.monotonic() - begun + 10
    assert fuzzer.counts()['agent'] == str(AGENT)


def test_an_agent_under_invalid_messages_gets_the_true_answers(
        processes: Processes, make_client: Callable[..., Client],
        make_node: Callable[..., Any], nightly: bool) -> None:
    processes.fork_node('rocket_sim_node', 'simulator', num_envs=N)
    client, world = make_client(), make('rocket', num_envs=N)
    stranger = make_node()[0]
    topics = {'observation': msg.Observation, 'reward': msg.Reward, 'episodes': msg.Episodes}
    publishers = {name: stranger.create_publisher(kind, name, qos.STREAM)
                  for name, kind in topics.items()}
    babble = stranger.create_publisher(msg.World, 'world', qos.WORLD)
    client.reset(1)
    world.reset(1)
    assert client.waiter.until(lambda: babble.get_subscription_count() > 0 and all(
        p.get_subscription_count() > 0 for p in publishers.values()), 10.0)
    rng = np.random.default_rng(1)
    for _ in range(10_000 if nightly else 1000):
        for name, kind in topics.items():
            codec = Codec(kind)
            fields = list(kind.get_fields_and_field_types().values())
            foreign = [int(n) for n in rng.integers(2**62, size=2)]
            data = codec.encode(foreign, [np.ones(N)] * (len(fields) - 2))
            if rng.integers(2):
                data = bytes(rng.bytes(int(rng.integers(100))))
            if rng.integers(4):
                data = damaged(data or b'\0', rng, str(rng.choice(DAMAGES)))
            publishers[name].publish(data or b'\0')
        babble.publish(bytes(rng.bytes(50)))
        action = rng.uniform(-1, 1, (N, 3)).astype(np.float32)
        assert_same(client.step(action), world.step(action))
    assert client.snapshot() == world.snapshot()
