# SPDX-License-Identifier: Apache-2.0
"""What carries the wire: how far it reaches, and Fast DDS as lock-step needs it.

Fast DDS takes some of its settings from nothing but an XML profile, which it finds by an
environment variable while the first node is made. The profiles here, `profiles/machine.xml` and
`profiles/network.xml`, are for nodes that reach this machine only, and for those that may have
peers beyond. Who sets up Fast DDS otherwise (a profile of one's own, a discovery server) has the
word: then there are none of ours, and a profile is checked before the node starts.

Each start takes other ports for its data. Fast DDS names its shared memory after them, and with
those of a process that was killed, as it would by default, its peers find it at once but write
into the memory of the dead one: for seconds, or, once that was removed, for good.

Not everybody uses shared memory both ways, see :class:`SharedMemory`.
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
from rocket_sim_node.wire.dds.profile import schema_path
from rocket_sim_node.wire.dds.shared_memory_cleanup import OWN_PORTS
from rocket_sim_node.wire.dds.shared_memory_cleanup import PROFILE
from rocket_sim_node.wire.dds.shared_memory_cleanup import SHARED_MEMORY

RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
_RANGES = ('LOCALHOST', 'SUBNET', 'OFF', 'SYSTEM_DEFAULT')
_PROFILES = ('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE')
_SKIP_DEFAULT = 'SKIP_DEFAULT_XML_FILE'
_DEFAULT_PROFILE = Path('DEFAULT_FASTDDS_PROFILES.xml')
"""which Fast DDS takes from the folder it is started in, without a word"""
_OWN_SETUP = ('ROS_DISCOVERY_SERVER', 'ROS2_EASY_MODE', 'FASTDDS_BUILTIN_TRANSPORTS')
_MACHINE, _NETWORK = (
    Path(__file__).parent / 'profiles' / name for name in ('machine.xml', 'network.xml'))
_DATA_OFFSET = 'HOVERSLAM_DATA_PORT_OFFSET'
_FIRST_PORT, _PORTS_OF_DOMAIN = 7400, 250
_USUAL_OFFSET = 11
"""ports of a domain and of its data (RTPS 2.2, 9.6.1.1)"""
_LAST_PORT = 65535


_BY_SHARED_MEMORY = '<transport_id>shared_memory</transport_id>'
_TRANSPORTS = '<userTransports>'
_BY_UDP = """<defaultUnicastLocatorList>
          <locator><udpv4>{address}</udpv4></locator>
        </defaultUnicastLocatorList>
        """


class TransportError(ValueError):
    """Fast DDS cannot be set up, or did not do as it was told."""


class SharedMemory(Enum):
    """What a node uses shared memory for, where it can; the rest goes over UDP."""

    BOTH_WAYS = auto()
    """Who is sent much, and must not lose it: observations of 4 096 rockets, 245 kB, are more than
    a socket holds as Linux comes."""

    TO_SEND = auto()
    """Who may be killed under load and shall be back at once. Readers and writers of a queue in
    shared memory take turns by a lock in it; whoever is killed while holding it, reading its own
    queue mostly, has all who write to it wait for Fast DDS's 1 s."""

    NEVER = auto()
    """Who only listens, and nobody shall depend on its going on. A reader that is stopped, by a
    debugger or by Ctrl-Z, leaves what it has not read in its writer's shared memory, and that may
    stay there when it goes on; what is free then is in pieces, and the writer's next message of
    40 kB fits into none of them, whoever it is for. Fast DDS (3.2, `SharedMemManager.hpp`) drops
    it without a word, again each time."""


def discovery_range() -> str:
    """Return how far peers are looked for: this machine only, unless the environment says."""
    if os.environ.get('ROS_LOCALHOST_ONLY') == '1':
        return 'LOCALHOST'
    return os.environ.get(RANGE) or 'LOCALHOST'


def beyond_machine() -> bool:
    """Return whether peers beyond this machine may be discovered, by range or by name."""
    if discovery_range() == 'OFF' or os.environ.get('ROS_LOCALHOST_ONLY') == '1':
        return False
    return bool(os.environ.get('ROS_STATIC_PEERS')) or discovery_range() != 'LOCALHOST'


def set_up_by_user() -> bool:
    """Return whether Fast DDS was told otherwise where its peers are, or how to reach them."""
    return bool(_user_profiles()) or any(os.environ.get(name) for name in _OWN_SETUP)


def _user_profiles() -> list[Path]:
    """Return the user's profiles: named, or lying where Fast DDS looks for one."""
    paths = [Path(os.environ[name]) for name in _PROFILES if os.environ.get(name)]
    if os.environ.get(_SKIP_DEFAULT) != '1' and _DEFAULT_PROFILE.exists():
        paths.append(_DEFAULT_PROFILE.absolute())
    return paths


@contextmanager
def prepared(rmw: str, shared_memory: SharedMemory = SharedMemory.BOTH_WAYS) -> Iterator[None]:
    """Have what is made inside, a context and its first node, use the right transport.

    The environment is as it was afterwards. Where another set-up than ours opens sockets beyond
    this machine although the range does not say so, that is told.

    :param rmw: name of the implementation of ROS 2's middleware.
    :param shared_memory: which way the node uses it.
    :raises ProfileError: for a profile of the user's that Fast DDS would not take.
    :raises TransportError: for a range that is none; when the node could be heard beyond this
        machine and must not.
    """
    if discovery_range() not in _RANGES:
        raise TransportError(
            f'{RANGE}: got {discovery_range()!r}, expected one of {", ".join(_RANGES)}')
    settings: dict[str, str | None] = {RANGE: discovery_range()}
    closed, profile = False, None
    fast_dds = rmw.startswith('rmw_fastrtps')
    schema = schema_path() if fast_dds else None
    own = fast_dds and _own_setup(schema)
    with ExitStack() as stack:
        if schema is not None and not own:
            closed = not beyond_machine()
            used = profile = _MACHINE if closed else _NETWORK
            if shared_memory is not SharedMemory.BOTH_WAYS:
                used = stack.enter_context(_with_less(shared_memory, profile, closed))
            settings |= {
                _PROFILES[0]: str(used), _SKIP_DEFAULT: '1',
                _DATA_OFFSET: str(fresh_data_offset(_domain()))}
            if closed and discovery_range() == 'LOCALHOST':
                # With its own name for it ROS 2 would add sockets that hear the network.
                settings |= {RANGE: 'SYSTEM_DEFAULT', 'ROS_LOCALHOST_ONLY': None}
        before = {name: os.environ.get(name) for name in settings}
        opened = open_ports()
        _set(settings)
        stack.callback(_set, before)
        yield
    found = ', '.join(sorted(set(open_ports()) - set(opened)))
    if closed and found:
        raise TransportError(
            f'Fast DDS listens on {found}, expected 127.0.0.1 only: it did not take {profile}')
    if found and fast_dds and not beyond_machine():
        get_logger('transport').warning(
            f'Fast DDS listens on {found}: as it was set up, others than this machine may be '
            f'heard, although {RANGE} is {discovery_range()}')


@contextmanager
def _with_less(shared_memory: SharedMemory, profile: Path, closed: bool) -> Iterator[Path]:
    """Yield the path of a copy of a profile whose participant uses shared memory less.

    Where shared memory is, as a full disk keeps nobody from starting. A file without a name would
    not do: Fast DDS looks for its real path.

    :raises TransportError: when it cannot be written.
    """
    head, tag, rest = profile.read_text('utf-8').partition(_TRANSPORTS)
    if shared_memory is SharedMemory.NEVER:
        rest = rest.replace(_BY_SHARED_MEMORY, '', 1)
    else:
        head += _BY_UDP.format(address='<address>127.0.0.1</address>' if closed else '')
    with ExitStack() as stack:
        try:
            file = stack.enter_context(tempfile.NamedTemporaryFile(
                'w', prefix=PROFILE, suffix=profile.suffix, encoding='utf-8',
                dir=SHARED_MEMORY if os.access(SHARED_MEMORY, os.W_OK) else None))
            file.write(f'{head}{tag}{rest}')
            file.flush()
        except OSError as error:
            raise TransportError(
                f'the profile for Fast DDS could not be written: {error}') from error
        yield Path(file.name)


def _own_setup(schema: Path | None) -> bool:
    """Return whether Fast DDS is set up by its user; check what profiles there are, if it can."""
    for path in _user_profiles():
        if schema is not None:
            check_profile(path, schema)
        else:
            get_logger('transport').warning(
                f'{path} is not checked: this Fast DDS came without a schema of profiles')
    return set_up_by_user()


def _domain() -> int:
    """Return the ROS domain; 0 for what is no number: ROS will say so."""
    text = os.environ.get('ROS_DOMAIN_ID', '')
    return int(text) if text.isdecimal() else 0


def fresh_data_offset(domain: int) -> int:
    """Return from where, beyond a domain's first port, a start counts its ports for data.

    Drawn at random from some ten thousands; in the highest domains, which have fewer, the usual.
    """
    first = _FIRST_PORT + _PORTS_OF_DOMAIN * domain
    low = max(OWN_PORTS - first, _PORTS_OF_DOMAIN)
    # Fast DDS counts up from there by two a participant, and goes on where a port is taken.
    count = (_LAST_PORT - _PORTS_OF_DOMAIN - first - low) // 2
    return low + 2 * secrets.randbelow(count) if count > 0 else _USUAL_OFFSET


def open_ports() -> list[str]:
    """Return the UDP ports of this process that are bound to more than 127.0.0.0/8."""
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
