# SPDX-License-Identifier: Apache-2.0
"""The lower bound of an exchange: the same bytes over a TCP socket on this machine and back.

Run as a program it is the peer: `python -m benchmarks.wire.tcp_floor N CORE`, which prints its
port.
"""
from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys

OBSERVATION, ACTION = 15, 3
"""numbers per rocket"""


def sizes(num_envs: int) -> tuple[int, int]:
    """Return the number of bytes to the simulator and back: data, session and step."""
    return num_envs * 4 * ACTION + 16, num_envs * (4 * OBSERVATION + 4 + 2) + 32


def exactly(connection: socket.socket, view: memoryview) -> bool:
    """Fill a view from a connection; return false if the peer has closed it."""
    done = 0
    while done < len(view):
        count = connection.recv_into(view[done:])
        if not count:
            return False
        done += count
    return True


class TcpFloor:
    """Exchanges messages with a peer, which runs in a process of its own."""

    def __init__(self, num_envs: int, core: int | None = None) -> None:
        """Start the peer and connect to it.

        :param core: index of the core to which the peer is pinned; None: not pinned.
        """
        there, back = sizes(num_envs)
        self._child = subprocess.Popen(
            [sys.executable, '-m', 'benchmarks.wire.tcp_floor', str(num_envs),
             '' if core is None else str(core)],
            stdout=subprocess.PIPE, text=True)
        assert self._child.stdout is not None
        port = int(self._child.stdout.readline())
        self._connection = socket.create_connection(('127.0.0.1', port))
        self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._ping, self._pong = bytes(there), memoryview(bytearray(back))

    def __call__(self) -> None:
        """Send the bytes of an action and wait for those of an answer."""
        self._connection.sendall(self._ping)
        if not exactly(self._connection, self._pong):
            raise RuntimeError('tcp_floor: the peer is gone')

    def close(self) -> None:
        """End the peer."""
        self._connection.close()
        self._child.wait(10.0)


def main() -> None:
    """Answer until the other end closes the connection."""
    there, back = sizes(int(sys.argv[1]))
    if sys.argv[2]:
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[int(sys.argv[2]) % len(cores)]})
    with socket.socket() as listener:
        listener.bind(('127.0.0.1', 0))
        listener.listen()
        print(listener.getsockname()[1], flush=True)
        connection, _ = listener.accept()
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    ping, pong = memoryview(bytearray(there)), bytes(back)
    # An end that is killed with an answer unread resets the connection instead of closing it.
    with contextlib.suppress(ConnectionError):
        while exactly(connection, ping):
            connection.sendall(pong)


if __name__ == '__main__':
    main()
