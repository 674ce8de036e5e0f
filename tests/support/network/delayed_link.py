# SPDX-License-Identifier: Apache-2.0
"""A link between two network namespaces that delays each packet, for kernels without netem.

This program makes a TUN device in each namespace and copies packets from one to the other.

    python -m support.network.delayed_link NAMESPACE NAMESPACE ADDRESS ADDRESS MILLISECONDS
"""
from __future__ import annotations

import ctypes
import fcntl
import os
import select
import struct
import subprocess
import sys
import time
from collections import deque
from contextlib import suppress

DEVICE = 'delayed'
_CLONE_NEWNET = 0x40000000
_TUNSETIFF = 0x400454CA
_TUN, _NO_PACKET_INFORMATION = 0x0001, 0x1000
_LARGEST = 65_536


def _enter(namespace: str) -> None:
    library = ctypes.CDLL(None, use_errno=True)
    with open(f'/run/netns/{namespace}') as file:
        if library.setns(file.fileno(), _CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), 'setns', namespace)


def _make(namespace: str, address: str) -> int:
    """Enter a namespace, make a TUN device in it and return its descriptor."""
    _enter(namespace)
    device = os.open('/dev/net/tun', os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(device, _TUNSETIFF, struct.pack(
        '16sH22x', DEVICE.encode(), _TUN | _NO_PACKET_INFORMATION))
    for command in (('addr', 'add', f'{address}/24', 'dev', DEVICE),
                    ('link', 'set', DEVICE, 'up')):
        subprocess.run(['ip', *command], check=True, capture_output=True, timeout=10)
    return device


def main(first: str, second: str, address: str, other: str, milliseconds: str) -> None:
    """Copy packets until this process is ended."""
    ends = _make(first, address), _make(second, other)
    delay = float(milliseconds) / 1000
    waiting: deque[tuple[float, int, bytes]] = deque()
    print('ready', flush=True)
    while True:
        pause = max(0.0, waiting[0][0] - time.monotonic()) if waiting else None
        for device in select.select(ends, (), (), pause)[0]:
            due = time.monotonic() + delay
            target = ends[1] if device == ends[0] else ends[0]
            with suppress(BlockingIOError):
                while True:
                    waiting.append((due, target, os.read(device, _LARGEST)))
        while waiting and waiting[0][0] <= time.monotonic():
            _, target, packet = waiting.popleft()
            with suppress(OSError):  # if the queue is full, the packet is lost, as in a network
                os.write(target, packet)


if __name__ == '__main__':
    main(*sys.argv[1:])
