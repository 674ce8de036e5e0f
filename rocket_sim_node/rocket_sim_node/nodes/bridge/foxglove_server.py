# SPDX-License-Identifier: Apache-2.0
"""Server to which Foxglove connects: the messages of topics, live over a WebSocket.

The messages are those of ROS 2, as CDR with their definitions (`ros2msg`), so Foxglove shows them
as it shows those of a bag or of a `foxglove_bridge`.
"""
from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from foxglove import Capability
from foxglove import Channel
from foxglove import Context
from foxglove import Schema
from foxglove import start_server
from foxglove.websocket import ChannelView
from foxglove.websocket import Client
from foxglove.websocket import ServerListener
from rclpy.serialization import serialize_message

from rocket_sim_node.bags.definitions import definition
from rocket_sim_node.nodes.bridge.topics import Outlet
from rocket_sim_node.recording.sinks.destinations import check_page
from rocket_sim_node.recording.sinks.destinations import far_host

_BACKLOG = 100
"""Messages kept for a viewer that does not keep up; then the oldest are dropped."""


class FoxgloveServer:
    """Serves messages to any number of viewers, which only listen."""

    def __init__(self, port: int, host: str) -> None:
        """Start to serve; there are no topics yet.

        :raises ValueError: when that port or address cannot be had.
        """
        check_page(port, host, 'foxglove')
        self._context = Context()
        self._latched: dict[int, Callable[[], None]] = {}
        self._asked: deque[int] = deque()
        self._time = 0
        try:
            self._server = start_server(
                name='hoverslam', host=host, port=port, capabilities=[Capability.Time],
                server_listener=_Latecomers(self._asked), context=self._context,
                message_backlog_size=_BACKLOG)
        except RuntimeError as error:  # taken since the check
            raise ValueError(f'foxglove_port: {port}: {error}') from None
        self.url = f'ws://{far_host(host)}:{port}'

    def topic(self, kind: Any, topic: str, latched: bool) -> Outlet:
        """Offer a topic.

        :param kind: of the messages, a class of an interface package.
        :param latched: whether viewers that come late get the last message.
        """
        name = f'{kind.__module__.partition(".")[0]}/msg/{kind.__name__}'
        channel = Channel(
            topic, message_encoding='cdr', context=self._context, schema=Schema(
                name=name, encoding='ros2msg', data=definition(name).encode()))
        last = b''

        def send_last() -> None:
            if last:
                channel.log(last, log_time=self._time)

        def send(message: Any) -> None:
            nonlocal last
            last = serialize_message(message)
            send_last()

        if latched:
            self._latched[channel.id()] = send_last
        return Outlet(send, channel.has_sinks)

    def serve_latecomers(self) -> None:
        """Send the last message of latched topics that viewers have subscribed to since.

        All viewers receive it: the server cannot single one out. Call this often.
        """
        asked = {self._asked.popleft() for _ in range(len(self._asked))}
        for number in sorted(asked & self._latched.keys()):
            self._latched[number]()

    def set_time(self, stamp: int) -> None:
        """Set the simulated time, ns, of what is sent from now on."""
        self._time = stamp
        self._server.broadcast_time(stamp)

    def close(self) -> None:
        """Serve no longer."""
        self._server.stop()


class _Latecomers(ServerListener):
    """Notes which channels viewers subscribe to; called by threads of the server."""

    def __init__(self, asked: deque[int]) -> None:
        """Note the channels' numbers in `asked`."""
        self._asked = asked

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Note that a viewer has subscribed."""
        self._asked.append(channel.id)
