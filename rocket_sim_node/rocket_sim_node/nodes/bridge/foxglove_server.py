# SPDX-License-Identifier: Apache-2.0
"""Server to which Foxglove connects: the messages of topics, live over a WebSocket.

The messages are those of ROS 2, as CDR with their definitions (`ros2msg`), so Foxglove shows them
as it shows those of a bag or of a `foxglove_bridge`.
"""
from __future__ import annotations

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
from rocket_sim_node.recording.sinks.destinations import check_page


class FoxgloveServer:
    """Serves messages to any number of viewers, which only listen."""

    def __init__(self, port: int, host: str) -> None:
        """Start to serve; there are no topics yet.

        :raises ValueError: when that port or address cannot be had.
        """
        check_page(port, host, 'foxglove')
        self._context = Context()
        self._latched: dict[int, Callable[[], None]] = {}
        self._time = 0
        self._server = start_server(
            name='hoverslam', host=host, port=port, capabilities=[Capability.Time],
            server_listener=_Latecomers(self._latched), context=self._context)
        self.url = f'ws://{host}:{port}'

    def topic(self, kind: Any, topic: str, latched: bool) -> Callable[[Any], None]:
        """Offer a topic; return the function that sends its messages.

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
            if latched or channel.has_sinks():
                last = serialize_message(message)
                send_last()

        if latched:
            self._latched[channel.id()] = send_last
        return send

    def set_time(self, stamp: int) -> None:
        """Set the simulated time, ns, of what is sent from now on."""
        self._time = stamp
        self._server.broadcast_time(stamp)

    def close(self) -> None:
        """Serve no longer."""
        self._server.stop()


class _Latecomers(ServerListener):
    """Sends the last message of a latched topic to those who subscribe to it."""

    def __init__(self, latched: dict[int, Callable[[], None]]) -> None:
        """Take a function for each channel, by its number."""
        self._latched = latched

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Send the last message again, to all viewers: the server cannot single one out."""
        if send_last := self._latched.get(channel.id):
            send_last()
