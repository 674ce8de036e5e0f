# SPDX-License-Identifier: Apache-2.0
"""A node that simulates a bad network: it relays messages between agent and simulator with faults.

The simulator is remapped to the topics `far/action` and so on (see `FAR`); the agent uses those
without `far`. In each direction some messages, chosen by a seed, are dropped, sent twice, delayed,
or sent after the next one. Run as a program, this module is the node.
"""
from __future__ import annotations

import heapq
import itertools
import json
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from support.processes import Process
from support.processes import Processes
from support.processes import wait_until

TOPICS = {'action': 'Action', 'observation': 'Observation', 'reward': 'Reward',
          'episodes': 'Episodes'}
FAR = tuple(f'{topic}:=far/{topic}' for topic in TOPICS)
"""remapping rules of the simulator"""
FAULTS = ('dropped', 'doubled', 'delayed', 'reordered')
_LONGEST_DELAY = 0.05
"""maximum delay, s"""
_LONGEST_HOLD = 0.1
"""s after which a message to be reordered is sent even if no other message has arrived"""


class Channel:
    """Relays one topic in one direction, with faults.

    :param share: share of messages affected by each of the four faults.
    :param send: function that sends a message.
    """

    def __init__(self, seed: list[int], share: float, send: Callable[[bytes], None]) -> None:
        self._random = np.random.default_rng(seed)
        self._share, self._send = share, send
        self._held: list[tuple[float, int, bytes]] = []
        self._overtaken: tuple[float, bytes] | None = None
        self._number = itertools.count()
        self.counts: Counter[str] = Counter()

    def take(self, message: bytes) -> None:
        """Draw a fault for a message and apply it."""
        self.counts['messages'] += 1
        lot = int(self._random.uniform() / self._share)
        fault = FAULTS[lot] if lot < len(FAULTS) else ''
        self.counts[fault] += 1
        now = time.monotonic()
        if fault == 'delayed':
            due = now + self._random.uniform(0.0, _LONGEST_DELAY)
            heapq.heappush(self._held, (due, next(self._number), message))
        elif fault == 'reordered' and self._overtaken is None:
            self._overtaken = now + _LONGEST_HOLD, message
        elif fault != 'dropped':
            for _ in range(2 if fault == 'doubled' else 1):
                self._send(message)
            self._release()

    def _release(self) -> None:
        if self._overtaken is not None:
            message, self._overtaken = self._overtaken[1], None
            self._send(message)

    def pass_on(self) -> None:
        """Send held messages that are due."""
        now = time.monotonic()
        while self._held and self._held[0][0] <= now:
            self._send(heapq.heappop(self._held)[2])
        if self._overtaken is not None and self._overtaken[0] <= now:
            self._release()


def start(processes: Processes, seed: int, share: float) -> tuple[Process, Path]:
    """Start the node; return it and the file to which it writes its counts."""
    output = processes.folder / f'interposer_{seed}.json'
    node = processes.start(
        'python', '-m', 'support.network.interposer', '--ros-args', '-p', f'seed:={seed}',
        '-p', f'share:={share}',
        '-p', f'output:={output}')
    node.wait_for('interposed', 30.0)
    return node, output


def stop(node: Process, output: Path) -> Counter[str]:
    """End the node; return the number of messages, in total and by fault."""
    node.end()
    wait_until(output.exists, 5.0, node.output)
    return Counter(json.loads(output.read_text()))


def interpose(node: Any, executor: Any) -> None:
    """Run the node."""
    from rocket_msgs import msg

    from rocket_sim_node.wire.dds import qos
    from rocket_sim_node.wire.node import stopping

    def parameter(name: str) -> Any:
        return node.get_parameter(name).value

    channels = []
    for number, (topic, kind) in enumerate(TOPICS.items()):
        near, far = topic, f'far/{topic}'
        source, sink = (near, far) if topic == 'action' else (far, near)
        profile = qos.EVENTS if topic == 'episodes' else qos.STREAM
        publisher = node.create_publisher(getattr(msg, kind), sink, profile)
        channel = Channel([parameter('seed'), number], parameter('share'), publisher.publish)
        node.create_subscription(
            getattr(msg, kind), source, channel.take,
            qos.EVENTS if topic == 'episodes' else qos.read_stream('auto'), raw=True)
        channels.append(channel)
    node.get_logger().info('interposed')
    while not stopping.requested():
        executor.spin_once(timeout_sec=0.002)
        for channel in channels:
            channel.pass_on()
    counts: Counter[str] = sum((channel.counts for channel in channels), Counter())
    Path(parameter('output')).write_text(json.dumps(counts))


if __name__ == '__main__':
    import sys

    from rocket_sim_node.wire.node.running import run
    sys.exit(run('interposer', interpose))
