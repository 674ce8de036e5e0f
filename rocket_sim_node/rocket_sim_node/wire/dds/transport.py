# SPDX-License-Identifier: Apache-2.0
"""Transport configuration of Fast DDS: network reach, ports and use of shared memory.

Some settings of Fast DDS can only be given by an XML profile, which it finds through an
environment variable while the first node is created. `profiles/machine.xml` is for nodes that
reach this machine only, `profiles/network.xml` for nodes that may have peers on others. A user's
own configuration (an XML profile, a discovery server) takes precedence: then none of ours is used,
and the user's profile is validated before the node starts.

Each start uses other data ports. Fast DDS names its shared memory after the ports. If a restarted
process had the ports of one that was killed, as by default, peers would discover it at once but
write into the dead process's memory: for seconds or, once that was removed, forever.

Some nodes use shared memory in one direction only, see :class:`SharedMemory`.
"""
from __future__ import annotations

import os
import secrets
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from contextlib import contextmanager
from enum import Enum
from enum import auto
from pathlib import Path

from rclpy.logging import get_logger

from rocket_sim_node.wire.dds.profile import check_profile
from rocket_sim_node.wire.dds.shared_memory_cleanup import OWN_PORTS
from rocket_sim_node.wire.dds.shared_memory_cleanup import PROFILE
from rocket_sim_node.wire.dds.shared_memory_cleanup import SHARED_MEMORY
from rocket_sim_node.wire.distributions import FastDds
from rocket_sim_node.wire.distributions import fast_dds

RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
_RANGES = ('LOCALHOST', 'SUBNET', 'OFF', 'SYSTEM_DEFAULT')
_SKIP_DEFAULT = 'SKIP_DEFAULT_XML_FILE'
_OWN_SETUP = ('ROS_DISCOVERY_SERVER', 'ROS2_EASY_MODE', 'FASTDDS_BUILTIN_TRANSPORTS')
_MACHINE, _NETWORK = (
    Path(__file__).parent / 'profiles' / name for name in ('machine.xml', 'network.xml'))
_DATA_OFFSET = 'HOVERSLAM_DATA_PORT_OFFSET'
_FIRST_PORT, _PORTS_OF_DOMAIN = 7400, 250
_USUAL_OFFSET = 11
"""Offset of a domain's data ports from its first port (RTPS 2.2, 9.6.1.1)."""
_LAST_PORT = 65535


_BY_SHARED_MEMORY = '<transport_id>shared_memory</transport_id>'
_TRANSPORTS = '<userTransports>'
_BY_UDP = """<defaultUnicastLocatorList>
          <locator><udpv4>{address}</udpv4></locator>
        </defaultUnicastLocatorList>
        """


class TransportError(ValueError):
    """Fast DDS cannot be configured, or did not apply its configuration."""


class SharedMemory(Enum):
    """Use of shared memory by a node, where available; everything else goes over UDP."""

    BOTH_WAYS = auto()
    """For receivers of large messages that must not be lost: observations of 4 096 rockets, 245
    kB, exceed Linux's default socket buffer."""

    TO_SEND = auto()
    """For processes that may be killed under load and must be back at once. Readers and writers of
    a shared-memory queue hold a lock in it; if a process is killed while holding it, mostly while
    reading its own queue, all writers to it wait for Fast DDS's time-out of 1 s."""

    NEVER = auto()
    """For passive listeners, which must not affect others when they stop. A reader stopped by a
    debugger or Ctrl-Z leaves unread messages in its writer's shared memory, which may stay there
    after it continues. The free memory is then fragmented, and the writer's next message of 40 kB
    does not fit, whichever reader it is for. Fast DDS (3.2, `SharedMemManager.hpp`) drops it
    silently, every time."""


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


def set_up_by_user() -> bool:
    """Return whether the user configured where Fast DDS finds its peers, or how to reach them."""
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
def prepared(rmw: str, shared_memory: SharedMemory = SharedMemory.BOTH_WAYS) -> Iterator[None]:
    """Configure the transport for the context and first node that are created inside.

    The environment is restored afterwards. A warning is logged if a user's own configuration opens
    sockets beyond this machine although the range does not say so.

    :param rmw: name of the ROS 2 middleware implementation.
    :param shared_memory: the node's use of shared memory.
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
    own = is_fast_dds and _own_setup(schema)
    with ExitStack() as stack:
        if is_fast_dds and schema is not None and not own:
            closed = not beyond_machine()
            profile = _MACHINE if closed else _NETWORK
            used = stack.enter_context(_adapted(profile, version, shared_memory, closed))
            settings |= {
                version.variables[0]: str(used), _SKIP_DEFAULT: '1',
                _DATA_OFFSET: str(fresh_data_offset(_domain()))}
            if closed and discovery_range() == 'LOCALHOST':
                # With LOCALHOST, ROS 2 would add sockets that listen on the network.
                settings |= {RANGE: 'SYSTEM_DEFAULT', 'ROS_LOCALHOST_ONLY': None}
        before = {name: os.environ.get(name) for name in settings}
        opened = open_ports()
        _set(settings)
        stack.callback(_set, before)
        yield
    found = ', '.join(sorted(set(open_ports()) - set(opened)))
    if closed and found:
        raise TransportError(
            f'Fast DDS listens on {found}, expected 127.0.0.1 only: it did not use {profile}')
    if found and is_fast_dds and not beyond_machine():
        get_logger('transport').warning(
            f'Fast DDS listens on {found}, so it may receive from other '
            f'machines, although {RANGE} is {discovery_range()}')


@contextmanager
def _adapted(
    profile: Path, version: FastDds, shared_memory: SharedMemory, closed: bool,
) -> Iterator[Path]:
    """Yield the path of a profile for this version of Fast DDS and this use of shared memory.

    A copy, where one is needed, lies in shared memory, so that a full disk does not prevent a
    start. An unnamed file would not work: Fast DDS resolves its real path.

    :raises TransportError: when it cannot be written.
    """
    original = profile.read_text('utf-8')
    head, tag, rest = version.spelled(original).partition(_TRANSPORTS)
    if shared_memory is SharedMemory.NEVER:
        rest = rest.replace(_BY_SHARED_MEMORY, '', 1)
    elif shared_memory is SharedMemory.TO_SEND:
        head += _BY_UDP.format(address='<address>127.0.0.1</address>' if closed else '')
    text = f'{head}{tag}{rest}'
    if text == original:
        yield profile
        return
    with ExitStack() as stack:
        try:
            file = stack.enter_context(tempfile.NamedTemporaryFile(
                'w', prefix=PROFILE, suffix=profile.suffix, encoding='utf-8',
                dir=SHARED_MEMORY if os.access(SHARED_MEMORY, os.W_OK) else None))
            file.write(text)
            file.flush()
        except OSError as error:
            raise TransportError(
                f'the profile for Fast DDS could not be written: {error}') from error
        yield Path(file.name)


def _own_setup(schema: Path | None) -> bool:
    """Return whether the user configured Fast DDS; validate the user's profiles if possible."""
    for path in _user_profiles():
        if schema is not None:
            check_profile(path, schema)
        else:
            get_logger('transport').warning(
                f'{path} is not checked: this Fast DDS installation has no schema of profiles')
    return set_up_by_user()


def _domain() -> int:
    """Return the ROS domain; 0 for an invalid number, which ROS reports itself."""
    text = os.environ.get('ROS_DOMAIN_ID', '')
    return int(text) if text.isdecimal() else 0


def fresh_data_offset(domain: int) -> int:
    """Return the offset of this start's data ports from the domain's first port.

    Drawn at random from some ten thousands; the highest domains have fewer and use the default.
    """
    first = _FIRST_PORT + _PORTS_OF_DOMAIN * domain
    low = max(OWN_PORTS - first, _PORTS_OF_DOMAIN)
    # Fast DDS counts up from there in steps of two per participant, and skips ports in use.
    count = (_LAST_PORT - _PORTS_OF_DOMAIN - first - low) // 2
    return low + 2 * secrets.randbelow(count) if count > 0 else _USUAL_OFFSET


def open_ports() -> list[str]:
    """Return this process's UDP ports that are bound beyond 127.0.0.0/8."""
    inodes = set()
    for link in Path('/proc/self/fd').iterdir():
        try:
            inodes.add(os.readlink(link))
        except OSError:  # closed meanwhile
            continue
    found = []
    for name in ('udp', 'udp6'):
        table = Path('/proc/self/net', name)
        for line in table.read_text('ascii').splitlines()[1:] if table.exists() else []:
            fields = line.split()
            address, port = fields[1].split(':')
            if f'socket:[{fields[9]}]' in inodes and not (name == 'udp' and address[6:] == '7F'):
                found.append(f'{name} port {int(port, 16)} of address {address}')
    return found


def _set(values: dict[str, str | None]) -> None:
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
