# SPDX-License-Identifier: Apache-2.0
"""Rendezvous of the ranks of a run, by the environment variables of torchrun.

RANK, WORLD_SIZE, MASTER_ADDR and MASTER_PORT: torchrun sets them for each process that it starts,
ROS nodes get them from the shell or the launch file.
"""
from __future__ import annotations

import ipaddress
import itertools
import os
import socket
import threading
import time
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Mapping
from contextlib import contextmanager
from contextlib import suppress
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

from torch import distributed

from ppo_agent_node.distributed.errors import RankLost
from ppo_agent_node.distributed.ranks import ALONE
from ppo_agent_node.distributed.ranks import Channel
from ppo_agent_node.distributed.ranks import Ranks
from ppo_agent_node.distributed.ranks import reason
from rocket_sim_node.worlds import EnvironmentClosed

JOIN_PATIENCE = 120.0
"""s for all ranks to be there"""
_COLLECTIVE_PATIENCE = timedelta(minutes=30)
"""Longest wait for another rank: for the slowest part of a roll-out or of cloning."""
_CONNECTION_PATIENCE = timedelta(minutes=1)
"""Longest wait for the store: torch looks up the name of its address, also where there is none."""
_FAREWELL_PATIENCE = 60.0
"""Longest wait until the others have learned of an error here, s."""
_INTERFACE = 'GLOO_SOCKET_IFNAME'
_RETRY = 0.1
"""s"""
_MOST_NAMED = 20
"""missing ranks in a message"""
_LARGEST_COUNT = 65_536
_CHANNELS = 3
_serial = itertools.count()
"""Numbers the rendezvous of this process: under torchrun all have the same store."""


@dataclass(frozen=True)
class _Place:
    """Settings of this rank, from the environment."""

    index: int
    count: int
    host: str
    port: int
    by_torchrun: bool
    """Whether torchrun has started it, and serves the store."""
    attempt: str
    """Number of the start under torchrun, which starts all ranks again when one fails."""

    @property
    def serves(self) -> bool:
        """Whether this rank serves the store."""
        return self.index == 0 and not self.by_torchrun


def _number(environment: Mapping[str, str], name: str, least: int, most: int) -> int:
    text = environment.get(name, '')
    value = int(text) if text.isascii() and text.isdigit() else -1
    if not least <= value <= most:
        raise ValueError(
            f'environment variable {name}: got {text!r:.200}, expected {least} to {most}')
    return value


def _place(environment: Mapping[str, str]) -> _Place | None:
    """Return this rank's place; None for a run of one rank.

    :raises ValueError: for a variable that is missing or wrong; names it.
    """
    if not environment.get('WORLD_SIZE'):
        if rank := environment.get('RANK'):
            raise ValueError(
                f'environment variable WORLD_SIZE: not set, although RANK is {rank!r:.200}; '
                'expected the number of ranks')
        return None
    count = _number(environment, 'WORLD_SIZE', 1, _LARGEST_COUNT)
    if count == 1:
        return None
    index = _number(environment, 'RANK', 0, count - 1)
    host = environment.get('MASTER_ADDR', '')
    if not host:
        raise ValueError('environment variable MASTER_ADDR: not set, expected the host of rank 0')
    return _Place(
        index, count, host, _number(environment, 'MASTER_PORT', 1, 65_535),
        environment.get('TORCHELASTIC_USE_AGENT_STORE') == 'True',
        environment.get('TORCHELASTIC_RESTART_COUNT', '0'))


def assignments(environment: Mapping[str, str] = os.environ) -> list[str]:
    """Return the variables by which this rank finds the others, as NAME=VALUE; none if alone."""
    if _place(environment) is None:
        return []
    names = ('RANK', 'WORLD_SIZE', 'MASTER_ADDR', 'MASTER_PORT')
    return [f'{name}={environment[name]}' for name in names]


@contextmanager
def joined(
    environment: Mapping[str, str] = os.environ, poll: Callable[[], None] = lambda: None,
    say: Callable[[str], None] = lambda text: None, patience: float = JOIN_PATIENCE,
) -> Iterator[Ranks]:
    """Connect to the other ranks of the run that the environment describes; disconnect at the end.

    Without WORLD_SIZE, or with 1, the run has one rank. If the body raises an error, it is told to
    the other ranks first, for which they get a minute: they raise it as RankLost.

    :param poll: called while waiting; may raise.
    :param say: called with a text when it has to wait, and when all are there.
    :param patience: s to wait for the others.
    :raises ValueError: for a variable that is missing or wrong; names it.
    :raises TimeoutError: when not all ranks are there in time.
    :raises OSError: when rank 0 cannot listen at the address.
    :raises RankLost: when another rank has ended or failed meanwhile.
    """
    place = _place(environment)
    if place is None:
        yield ALONE
        return
    deadline = time.monotonic() + patience
    before = os.environ.get(_INTERFACE)
    if _is_loopback(place.host):
        # Otherwise gloo listens on the address of the host's name.
        os.environ.setdefault(_INTERFACE, 'lo')
    try:
        say(f'rank {place.index} of {place.count}: waiting for the others at '
            f'{place.host}:{place.port}')
        groups = _connect(place, _meet(place, poll, deadline), poll, deadline)
        say(f'rank {place.index} of {place.count}: all ranks are here')
        ranks = Ranks(place.index, place.count, *(
            Channel(place.index, place.count, group) for group in groups))
        try:
            yield ranks
        except (EnvironmentClosed, RankLost):
            raise
        except Exception as error:
            say(f'rank {place.index} of {place.count}: has failed, and tells the others')
            _tell(ranks.main, error, poll)
            raise
    finally:
        if before is None:
            os.environ.pop(_INTERFACE, None)
        if distributed.is_initialized():
            with suppress(RuntimeError):  # another rank has ended before
                distributed.destroy_process_group()


def _tell(main: Channel, error: Exception, poll: Callable[[], None]) -> None:
    """Tell the other ranks of an error, if they come to listen in time."""
    deadline = time.monotonic() + _FAREWELL_PATIENCE

    def poll_in_time() -> None:
        poll()
        if time.monotonic() > deadline:
            raise TimeoutError('the other ranks do not listen')

    with suppress(Exception):  # the error itself says more
        main.fail(error, poll_in_time)


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == 'localhost'


def _listen(host: str, port: int) -> int:
    """Return the descriptor of a socket that listens."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family).detach()
    except OSError as error:
        raise OSError(
            error.errno, f'rank 0 cannot listen here: {error.strerror}',
            f'{host}:{port}') from error


def _answers(host: str, port: int) -> bool:
    """Return whether something listens: the store prints traces of C++ when nothing does."""
    try:
        socket.create_connection((host, port), timeout=1.0).close()
    except OSError:
        return False
    return True


def _meet(place: _Place, poll: Callable[[], None], deadline: float) -> distributed.Store:
    """Return the store of a run when all ranks are there."""
    # On the given address only: by itself the store would listen on all.
    listening = _listen(place.host, place.port) if place.serves else None
    store = None
    here = 0
    prefix = f'hoverslam/{place.attempt}/{next(_serial) if place.by_torchrun else 0}'
    while True:
        poll()
        try:
            if store is None and (place.serves or _answers(place.host, place.port)):
                store = distributed.PrefixStore(prefix, distributed.TCPStore(
                    place.host, place.port, is_master=place.serves, wait_for_workers=False,
                    timeout=_CONNECTION_PATIENCE, master_listen_fd=listening))
                _announce(store, place)
            if store is not None:
                here = store.add('here', 0)
                if here == place.count:
                    store.set_timeout(_COLLECTIVE_PATIENCE)
                    return store
        except distributed.DistError as error:
            if place.serves:
                raise OSError(
                    f'{place.host}:{place.port}: {reason(error)}') from error
            store = None
        if time.monotonic() > deadline:
            raise TimeoutError(
                f'rank {place.index}: {here} of {place.count} ranks are at '
                f'{place.host}:{place.port}{_missing(store, place.count)}, expected all')
        time.sleep(_RETRY)


def _missing(store: distributed.Store | None, count: int) -> str:
    """Return the end of a message with the first ranks that are not in the store."""
    if store is None:
        return ''
    try:
        missing = (rank for rank in range(count) if not store.check([f'rank/{rank}']))
        return f', missing: {" ".join(map(str, itertools.islice(missing, _MOST_NAMED)))}'
    except distributed.DistError:  # rank 0 has ended
        return ''


def _announce(store: distributed.Store, place: _Place) -> None:
    """Tell the others that this rank is here.

    :raises ValueError: when another one has the same number, or counts the ranks differently.
    """
    theirs = store.compare_set('count', '', str(place.count)).decode()
    if theirs != str(place.count):
        raise ValueError(
            f'environment variable WORLD_SIZE: got {place.count}, another rank has {theirs}, '
            'expected the same on all ranks')
    if store.add(f'rank/{place.index}', 1) > 1:
        raise ValueError(
            f'environment variable RANK: got {place.index}, which another process has, expected '
            'a number of its own for each rank')
    store.add('here', 1)


def _connect(
    place: _Place, store: distributed.Store, poll: Callable[[], None], deadline: float,
) -> list[Any]:
    """Return a process group for each channel.

    In a thread, as torch waits for the others without looking for a stop request.
    """
    groups: list[Any] = []
    errors: list[Exception] = []

    def connect() -> None:
        try:
            distributed.init_process_group(
                'gloo', store=store, rank=place.index, world_size=place.count,
                timeout=_COLLECTIVE_PATIENCE)
            for _ in range(_CHANNELS):
                groups.append(distributed.new_group(timeout=_COLLECTIVE_PATIENCE))
        except Exception as error:  # noqa: BLE001 (told by the thread that waits)
            errors.append(error)

    thread = threading.Thread(target=connect, daemon=True)
    thread.start()
    while thread.is_alive():
        poll()
        if time.monotonic() > deadline:
            raise TimeoutError(
                f'rank {place.index}: not connected to all of {place.count} ranks in time')
        thread.join(_RETRY)
    if errors:
        raise RankLost(
            f'rank {place.index} of {place.count} cannot connect to the others '
            f'({reason(errors[0])})') from errors[0]
    return groups
