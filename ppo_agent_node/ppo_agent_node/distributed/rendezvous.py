# SPDX-License-Identifier: Apache-2.0
"""Rendezvous of the ranks of a run, by the environment variables of torchrun.

RANK, WORLD_SIZE, MASTER_ADDR and MASTER_PORT: torchrun sets them for each process that it starts,
ROS nodes get them from the shell or the launch file.
"""
from __future__ import annotations

import ipaddress
import os
import socket
import time
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Mapping
from contextlib import contextmanager
from contextlib import suppress
from datetime import timedelta

import torch
from torch import distributed

from ppo_agent_node.distributed.ranks import ALONE
from ppo_agent_node.distributed.ranks import Channel
from ppo_agent_node.distributed.ranks import Ranks

JOIN_PATIENCE = 120.0
"""s for all ranks to be there"""
_COLLECTIVE_PATIENCE = timedelta(minutes=30)
"""Longest wait for another rank: for the slowest part of a roll-out or of cloning."""
_CONNECTION_PATIENCE = timedelta(minutes=1)
"""Longest wait for the store: torch looks up the name of its address, also where there is none."""
_INTERFACE = 'GLOO_SOCKET_IFNAME'
_RETRY = 0.1
"""s"""
_LARGEST_COUNT = 65_536


def _number(environment: Mapping[str, str], name: str, least: int, most: int) -> int:
    text = environment.get(name, '')
    value = int(text) if text.isascii() and text.isdigit() else -1
    if not least <= value <= most:
        raise ValueError(
            f'environment variable {name}: got {text!r:.200}, expected {least} to {most}')
    return value


def _address(environment: Mapping[str, str]) -> tuple[str, int]:
    host = environment.get('MASTER_ADDR', '')
    if not host:
        raise ValueError('environment variable MASTER_ADDR: not set, expected the host of rank 0')
    return host, _number(environment, 'MASTER_PORT', 1, 65_535)


@contextmanager
def joined(
    environment: Mapping[str, str] = os.environ, poll: Callable[[], None] = lambda: None,
    say: Callable[[str], None] = lambda text: None, patience: float = JOIN_PATIENCE,
) -> Iterator[Ranks]:
    """Meet the other ranks of the run that the environment describes; part at the end.

    Without WORLD_SIZE, or with 1, the run has one rank.

    :param poll: called while waiting; may raise.
    :param say: called with a text when it has to wait, and when all are there.
    :param patience: s to wait for the others.
    :raises ValueError: for a variable that is missing or wrong; names it.
    :raises TimeoutError: when not all ranks are there in time.
    :raises OSError: when rank 0 cannot listen at the address.
    """
    if not environment.get('WORLD_SIZE'):
        yield ALONE
        return
    count = _number(environment, 'WORLD_SIZE', 1, _LARGEST_COUNT)
    index = _number(environment, 'RANK', 0, count - 1)
    if count == 1:
        yield ALONE
        return
    host, port = _address(environment)
    if _is_loopback(host):
        # Otherwise gloo listens on the address of the host's name.
        os.environ.setdefault(_INTERFACE, 'lo')
    say(f'rank {index} of {count}: waiting for the others at {host}:{port}')
    store = _meet(environment, host, port, index, count, poll, patience)
    backend = 'cpu:gloo,cuda:nccl' if torch.cuda.is_available() else 'gloo'
    distributed.init_process_group(
        backend, store=store, rank=index, world_size=count, timeout=_COLLECTIVE_PATIENCE)
    try:
        groups = [distributed.new_group(timeout=_COLLECTIVE_PATIENCE) for _ in range(3)]
        say(f'rank {index} of {count}: all ranks are here')
        yield Ranks(index, count, *(Channel(index, count, group) for group in groups))
    finally:
        with suppress(RuntimeError):  # another rank has ended before
            distributed.destroy_process_group()


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == 'localhost'


def _listen(host: str, port: int) -> int:
    """Return the descriptor of a socket that listens."""
    try:
        return socket.create_server((host, port)).detach()
    except OSError as error:
        reason = f'rank 0 cannot listen here: {error.strerror}'
        raise OSError(error.errno, reason, f'{host}:{port}') from error


def _first_line(error: Exception) -> str:
    return str(error).strip().partition('\n')[0]


def _answers(host: str, port: int) -> bool:
    """Return whether something listens: the store prints traces of C++ when nothing does."""
    try:
        socket.create_connection((host, port), timeout=1.0).close()
    except OSError:
        return False
    return True


def _meet(
    environment: Mapping[str, str], host: str, port: int, index: int, count: int,
    poll: Callable[[], None], patience: float,
) -> distributed.Store:
    """Return the store of a run when all ranks are there."""
    # torchrun serves the store itself; otherwise rank 0 does.
    serves = index == 0 and environment.get('TORCHELASTIC_USE_AGENT_STORE') != 'True'
    attempt = environment.get('TORCHELASTIC_RESTART_COUNT', '0')
    deadline = time.monotonic() + patience
    store = None
    here = 0
    # On the given address only: by itself the store would listen on all.
    listening = _listen(host, port) if serves else None
    while True:
        poll()
        try:
            if store is None and (serves or _answers(host, port)):
                store = distributed.PrefixStore(f'hoverslam/{attempt}', distributed.TCPStore(
                    host, port, is_master=serves, wait_for_workers=False,
                    timeout=_CONNECTION_PATIENCE, master_listen_fd=listening))
                store.set(f'here/{index}', '')
            if store is not None:
                here = sum(store.check([f'here/{rank}']) for rank in range(count))
                if here == count:
                    store.set_timeout(_COLLECTIVE_PATIENCE)
                    return store
        except distributed.DistError as error:
            if serves:
                raise OSError(f'{host}:{port}: {_first_line(error)}') from error
            store = None
        if time.monotonic() > deadline:
            raise TimeoutError(
                f'rank {index}: {here} of {count} ranks are at {host}:{port} after '
                f'{patience:.0f} s, expected all')
        time.sleep(_RETRY)
