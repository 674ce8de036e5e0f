# SPDX-License-Identifier: Apache-2.0
"""Starts participants with Fast DDS as it comes while others remove what the dead left.

To be run where /dev/shm is nobody else's. Prints how many of them lost their port.
"""
from __future__ import annotations

import contextlib
import os
import random
import signal
import sys
import time
from collections.abc import Callable

import rclpy

from rocket_sim_node.wire.dds import shared_memory_cleanup

SHARED_MEMORY = shared_memory_cleanup.SHARED_MEMORY
PORTS = (7000, 7001, 7002)
"""which a participant tries first"""
CLEANERS = 2


def fork(body: Callable[[], None]) -> int:
    """Run something in a process of its own."""
    child = os.fork()
    if not child:
        body()
        os._exit(0)
    return child


def participate() -> None:
    """Be a participant until killed."""
    rclpy.init()
    node = rclpy.create_node('beside')
    (SHARED_MEMORY / 'ready').touch()
    time.sleep(60.0)
    node.destroy_node()


def started(beside: Callable[[], list[int]]) -> float:
    """Start a participant, with others beside it; return after how many s it was ready."""
    begin = time.monotonic()
    child = fork(participate)
    others = beside()
    while not (SHARED_MEMORY / 'ready').exists():
        assert time.monotonic() < begin + 30.0, 'the participant does not start'
        time.sleep(0.001)
    took = time.monotonic() - begin
    for other in others:
        os.waitpid(other, 0)
    lost = [lock for lock in SHARED_MEMORY.glob('fast*_port*_el')
            if not lock.with_name(lock.name.removesuffix('_el')).exists()]
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    if lost:
        print('lost', *(lock.name for lock in lost))
    return took


def clear() -> None:
    """Have nothing in shared memory."""
    for file in SHARED_MEMORY.iterdir():
        with contextlib.suppress(OSError):
            file.unlink()


def main(rounds: int) -> None:
    """Start participants, one after the other."""
    clear()
    usual = started(list)
    (first,) = SHARED_MEMORY.glob(f'fast*_port{PORTS[0]}')  # named after DDS or RTPS, by version
    port = first.read_bytes()
    ports = [first.with_name(f'{first.name[:-4]}{number}') for number in PORTS]
    for _ in range(rounds):
        clear()
        for file in ports:
            file.write_bytes(port)
            os.utime(file, (0, 0))

        def clean() -> None:
            random.seed()
            time.sleep(usual * random.uniform(0.6, 0.95))
            shared_memory_cleanup.clean()

        started(lambda: [fork(clean) for _ in range(CLEANERS)])
    print('done', rounds)


if __name__ == '__main__':
    main(int(sys.argv[1]))
