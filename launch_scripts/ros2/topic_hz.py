# SPDX-License-Identifier: Apache-2.0
"""Print the average publishing rate to screen."""
from __future__ import annotations

import argparse
import collections
import statistics
import time
from typing import Any

import rclpy
from rclpy.qos import qos_profile_sensor_data

from ros2 import graph
from ros2.errors import CommandError

_WINDOW = 10000
_PERIOD = 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    graph.add_arguments(parser)
    parser.add_argument(
        'topic_name', nargs='+', help="Names of the ROS topic to listen to (e.g. '/chatter')")
    parser.add_argument(
        '--window', '-w', dest='window_size', type=int, default=_WINDOW, metavar='WINDOW',
        help=f'window size, in # of messages, for calculating rate (default: {_WINDOW})')
    parser.add_argument(
        '--wall-time', action='store_true', help='calculates rate using wall time')


class Rate:
    """Times between the messages of one topic."""

    def __init__(self, window: int) -> None:
        """Keep the last `window` of them, in seconds."""
        self._deltas: collections.deque[float] = collections.deque(maxlen=window)
        self._last: float | None = None
        self._new = False

    def tick(self, now: float) -> None:
        """Note that a message came at `now` seconds."""
        if self._last is not None and now >= self._last:
            self._deltas.append(now - self._last)
            self._new = True
        elif self._last is not None:
            self._deltas.clear()
        self._last = now

    def text(self) -> str | None:
        """Return the two lines of the real command, or None when nothing is new."""
        if not self._new:
            return None
        self._new = False
        deltas = list(self._deltas)
        mean = statistics.fmean(deltas)
        rate = 1.0 / mean if mean > 0.0 else 0.0
        return (
            f'average rate: {rate:.3f}\n\tmin: {min(deltas):.3f}s max: {max(deltas):.3f}s '
            f'std dev: {statistics.pstdev(deltas):.5f}s window: {len(deltas)}')


def main(args: argparse.Namespace) -> None:
    """Print rates until the end."""
    if args.window_size < 1:
        raise CommandError('argument --window/-w: value must be a positive integer')
    with graph.direct_node(args) as node:
        rates: dict[str, Rate] = {}
        for name in args.topic_name:
            topic = graph.absolute(name)
            kind = graph.topic_type(node, args, topic)
            if kind is None:
                print(f'WARNING: topic [{name}] does not appear to be published yet', flush=True)
            while kind is None:
                kind = graph.topic_type(node, args, topic)
            rate = rates[name] = Rate(args.window_size)

            def on_message(message: Any, rate: Rate = rate) -> None:
                rate.tick(time.monotonic())

            node.create_subscription(kind, topic, on_message, qos_profile_sensor_data, raw=True)
        due = time.monotonic() + _PERIOD
        while True:
            rclpy.spin_once(node, timeout_sec=max(0.0, due - time.monotonic()))
            if time.monotonic() < due:
                continue
            due = time.monotonic() + _PERIOD
            for name, rate in rates.items():
                text = rate.text()
                if text is not None:
                    print(text if len(rates) == 1 else f'{name}\n{text}', flush=True)
