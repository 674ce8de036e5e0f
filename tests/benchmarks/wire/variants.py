# SPDX-License-Identifier: Apache-2.0
"""Variants of the communication code, each compared with the present code.

Two simulators run side by side, one of which, like its client, uses the variant. Exchanges with
the two alternate, so that other load affects both.
"""
from __future__ import annotations

import itertools
import tempfile
import time
from collections.abc import Iterator
from collections.abc import Sequence
from contextlib import ExitStack
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from support.processes import Processes

from benchmarks.wire.agent_node import agent_node
from rocket_sim_node.wire.client import connection
from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.messages.cdr import Codec
from rocket_sim_node.wire.messages.conversion import from_sequence
from rocket_sim_node.wire.messages.conversion import to_sequence
from rocket_sim_node.wire.node import polling
from rocket_sim_node.wire.node.peer import Peer
from rocket_sim_node.wire.server import step_messages
from rocket_sim_node.wire.server.duplicate_simulators import DuplicateDetector


class Unchecked:
    """Messages are accepted without a check of their sender."""

    used = False
    """whether this process uses the variant at the moment"""
    words = ('with the checks of senders', 'without')

    @classmethod
    @contextmanager
    def installed(cls) -> Iterator[None]:
        """Patch the code so that `used` selects the variant."""
        sender_of, accepts, look = polling.sender_of, Peer.accepts, DuplicateDetector.look
        with (mock.patch.object(
                polling, 'sender_of', lambda info: b'' if cls.used else sender_of(info)),
              mock.patch.object(Peer, 'accepts', lambda *args: cls.used or accepts(*args)),
              mock.patch.object(
                  DuplicateDetector, 'look', lambda self: not cls.used and look(self))):
            yield


class RosidlCodec(Codec):
    """Conversion by rosidl to objects with an `array.array` per sequence, its fastest way."""

    def encode(self, numbers: Sequence[int], arrays: Sequence[NDArray[Any]]) -> Any:
        """Return a message, which rclpy serializes when it publishes it."""
        message = self.kind()
        for number, (name, _, _) in zip(numbers, self._fields[:self._first], strict=True):
            setattr(message, name, number)
        for values, (name, dtype, _) in zip(arrays, self._fields[self._first:], strict=True):
            setattr(message, name, to_sequence(values, dtype.str[1:]))
        return message

    def decode(self, data: Any) -> Any:
        """Return the fields of a message that rclpy has deserialized."""
        return self._make([
            from_sequence(getattr(data, name), dtype.str) if is_sequence else getattr(data, name)
            for name, dtype, is_sequence in self._fields])


class Rosidl:
    """Step messages are converted by rclpy and rosidl."""

    used = False
    """whether new clients and simulators use the variant"""
    words = ('with our codec', 'with that of rosidl')

    @classmethod
    @contextmanager
    def installed(cls) -> Iterator[None]:
        """Patch the code so that `used` selects the variant."""
        fetch = polling.ArraySubscription._fetch

        def codec(kind: Any) -> Codec:
            return RosidlCodec(kind) if cls.used else Codec(kind)

        def fetched(subscription: Any) -> Any:
            if not isinstance(subscription._codec, RosidlCodec):
                return fetch(subscription)
            with subscription.handle:
                return subscription.handle.take_message(subscription._kind, False)

        with (mock.patch.object(connection, 'Codec', codec),
              mock.patch.object(polling, 'Codec', codec),
              mock.patch.object(step_messages, 'Codec', codec),
              mock.patch.object(polling.ArraySubscription, '_fetch', fetched)):
            yield


VARIANTS: dict[str, type[Unchecked | Rosidl]] = {'unchecked': Unchecked, 'rosidl': Rosidl}
"""variant by the argument of `benchmarks.wire.still_world`"""


def measure(
    name: str, num_envs: int, rounds: int, count: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the times of exchanges without and with a variant, us: `(rounds, count)` each."""
    variant = VARIANTS[name]
    found = np.empty((2, rounds + 1, count))
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        processes = Processes(Path(folder))
        stack.callback(processes.end)
        stack.enter_context(variant.installed())
        clients = []
        for used in (False, True):
            simulator = processes.start(
                'python', '-m', 'benchmarks.wire.still_world', str(num_envs),
                *([name] if used else []), '--ros-args', '-r', f'__ns:=/sim_{used:d}')
            simulator.wait_for('waiting for an agent', 60.0)
            variant.used = used
            node, executor = stack.enter_context(
                agent_node('bench_variants', processes.domain, f'/sim_{used:d}'))
            clients.append(stack.enter_context(Client(node, executor)))
            clients[-1].reset(0)
        action = np.zeros((num_envs, 3), np.float32)
        for number, k in itertools.product(range(rounds + 1), range(count)):
            for used in sorted((False, True), reverse=k % 2 == 1):
                variant.used = used
                start = time.perf_counter()
                clients[used].step(action)
                found[int(used), number, k] = 1e6 * (time.perf_counter() - start)
    return found[0, 1:], found[1, 1:]


def report(name: str, num_envs: int, rounds: int, count: int) -> dict[str, float]:
    """Measure, and print and return medians and the ratio with its 95 % interval."""
    ours, others = (np.median(times, 1) for times in measure(name, num_envs, rounds, count))
    ratios = ours / others
    interval = stats.bootstrap(
        (ratios,), np.median, confidence_level=0.95, method='percentile',
        rng=np.random.default_rng(0)).confidence_interval
    row = {'as_it_is': float(np.median(ours)), name: float(np.median(others)),
           'ratio': float(np.median(ratios)), 'low': float(interval.low),
           'high': float(interval.high)}
    here, there = VARIANTS[name].words
    print(f'batch {num_envs}: {row["as_it_is"]:.0f} us {here}, {row[name]:.0f} us {there}; ratio '
          f'of the medians of {count}, median of {rounds} rounds: {row["ratio"]:.3f} '
          f'({row["low"]:.3f} to {row["high"]:.3f})', flush=True)
    return row
