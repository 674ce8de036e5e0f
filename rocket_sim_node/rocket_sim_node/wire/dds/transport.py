# SPDX-License-Identifier: Apache-2.0
"""Transport configuration of Fast DDS: how far a node reaches, and its sockets.

Some settings of Fast DDS can only be given by an XML profile, which it finds through an
environment variable while the first node is created. In `profiles/`, for each version of Fast
DDS, `machine.xml` is for nodes that reach this machine only, `network.xml` for nodes that may have
peers on others. With both, all messages go over UDP (docs/explanation/fast-dds.md gives the
reasons). With a discovery server, `server.xml` leaves all settings as they are, except that more
nodes get ports. A user's own XML profile takes precedence: then none of ours is used, and the
user's is validated before the node starts.
"""
from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from contextlib import suppress
from pathlib import Path

from rclpy.logging import get_logger

from rocket_sim_node.wire.dds.profile import check_profile
from rocket_sim_node.wire.distributions import fast_dds

RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
_RANGES = ('LOCALHOST', 'SUBNET', 'OFF', 'SYSTEM_DEFAULT')
_SKIP_DEFAULT = 'SKIP_DEFAULT_XML_FILE'
_SERVER = 'ROS_DISCOVERY_SERVER'
_OWN_SETUP = ('ROS2_EASY_MODE', 'FASTDDS_BUILTIN_TRANSPORTS')


class TransportError(ValueError):
    """Fast DDS cannot be configured, or did not apply its configuration."""


def discovery_range() -> str:
    """Return the discovery range: this machine only, unless the environment says otherwise."""
    if os.environ.get('ROS_LOCALHOST_ONLY') == '1':
        return 'LOCALHOST'
    return os.environ.get(RANGE) or 'LOCALHOST'


def beyond_machine() -> bool:
    """Return whether peers on other machines may be discovered, by range or by name."""
    if discovery_range() == 'OFF' or os.environ.get('ROS_LOCALHOST_ONLY') == '1':
        return False
    return bool(os.environ.get('ROS_STATIC_PEERS')) or discovery_range() != 'LOCALHOST'


def receive_buffer() -> int | None:
    """Return the size of the largest receive buffer that a UDP socket of this process was granted.

    It is in bytes; None without such a socket. Linux reserves twice as much (`man 7 socket`).
    """
    sizes = []
    usual = socket.getdefaulttimeout()
    socket.setdefaulttimeout(None)  # it would make the sockets of Fast DDS non-blocking
    try:
        for descriptor, *_ in _udp_sockets():
            with suppress(OSError):  # closed meanwhile
                one = socket.socket(fileno=descriptor)
                try:
                    sizes.append(one.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2)
                finally:
                    one.detach()
    finally:
        socket.setdefaulttimeout(usual)
    return max(sizes, default=None)


def set_up_by_user() -> bool:
    """Return whether the user configured where Fast DDS finds its peers, or how to reach them."""
    return bool(os.environ.get(_SERVER)) or _replaces_profiles()


def _replaces_profiles() -> bool:
    """Return whether the user has settings that one of our profiles would replace."""
    return bool(_user_profiles()) or any(os.environ.get(name) for name in _OWN_SETUP)


def _user_profiles() -> list[Path]:
    """Return the user's profiles: named explicitly, or in Fast DDS's default location."""
    version, _ = fast_dds()
    paths = [Path(os.environ[name]) for name in version.variables if os.environ.get(name)]
    default = Path(version.default)
    if os.environ.get(_SKIP_DEFAULT) != '1' and default.exists():
        paths.append(default.absolute())
    return paths


@contextmanager
def prepared(rmw: str) -> Iterator[None]:
    """Configure the transport for the context and first node that are created inside.

    The environment is restored afterwards. A warning is logged if a user's own configuration opens
    sockets beyond this machine although the range does not say so.

    :param rmw: name of the ROS 2 middleware implementation.
    :raises ProfileError: for a user's profile that Fast DDS would reject.
    :raises TransportError: for an invalid range; when the node could be reached from beyond this
        machine and must not.
    """
    if discovery_range() not in _RANGES:
        raise TransportError(
            f'{RANGE}: got {discovery_range()!r}, expected one of {", ".join(_RANGES)}')
    settings: dict[str, str | None] = {RANGE: discovery_range()}
    closed, profile = False, None
    is_fast_dds = rmw.startswith('rmw_fastrtps')
    version, schema = fast_dds()
    if is_fast_dds:
        _check_profiles(schema)
    if is_fast_dds and schema is not None and not _replaces_profiles():
        server = bool(os.environ.get(_SERVER))
        closed = not server and not beyond_machine()
        profile = version.profiles / (
            'server.xml' if server else 'machine.xml' if closed else 'network.xml')
        settings |= {version.variables[0]: str(profile), _SKIP_DEFAULT: '1'}
        if closed and discovery_range() == 'LOCALHOST':
            # With LOCALHOST, ROS 2 would add sockets that listen on the network.
            settings |= {RANGE: 'SYSTEM_DEFAULT', 'ROS_LOCALHOST_ONLY': None}
    before = {name: os.environ.get(name) for name in settings}
    opened = open_ports()
    _set(settings)
    try:
        yield
    finally:
        _set(before)
    found = ', '.join(sorted(set(open_ports()) - set(opened)))
    if closed and found:
        raise TransportError(
            f'Fast DDS listens on {found}, expected 127.0.0.1 only: it did not use {profile}')
    if found and is_fast_dds and not beyond_machine():
        get_logger('transport').warning(
            f'Fast DDS listens on {found}, so it may receive from other '
            f'machines, although {RANGE} is {discovery_range()}')


def _check_profiles(schema: Path | None) -> None:
    """Validate the user's profiles if possible."""
    for path in _user_profiles():
        if schema is not None:
            check_profile(path, schema)
        else:
            get_logger('transport').warning(
                f'{path} is not checked: this Fast DDS installation has no schema of profiles')


def open_ports() -> list[str]:
    """Return this process's UDP ports that are bound beyond 127.0.0.0/8."""
    return [f'{name} port {port} of address {address}'
            for _, name, address, port in _udp_sockets()
            if not (name == 'udp' and address.endswith('7F'))]


def _udp_sockets() -> Iterator[tuple[int, str, str, int]]:
    """Yield descriptor, protocol, address and port of this process's bound UDP sockets."""
    descriptors = {}
    for link in Path('/proc/self/fd').iterdir():
        with suppress(OSError):  # closed meanwhile
            descriptors[os.readlink(link)] = int(link.name)
    for name in ('udp', 'udp6'):
        table = Path('/proc/self/net', name)
        for line in table.read_text('ascii').splitlines()[1:] if table.exists() else []:
            fields = line.split()
            descriptor = descriptors.get(f'socket:[{fields[9]}]')
            if descriptor is not None:
                address, port = fields[1].split(':')
                yield descriptor, name, address, int(port, 16)


def _set(values: dict[str, str | None]) -> None:
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
