# SPDX-License-Identifier: Apache-2.0
"""Settings of Fast DDS: our profiles, a user's, and the environment while a node starts."""
from __future__ import annotations

import itertools
import os
import socket
from pathlib import Path
from unittest.mock import Mock
from xml.etree import ElementTree

import pytest

from rocket_sim_node.wire.dds import transport
from rocket_sim_node.wire.dds.profile import ProfileError
from rocket_sim_node.wire.dds.profile import check_profile
from rocket_sim_node.wire.distributions import FAST_DDS_2
from rocket_sim_node.wire.distributions import FAST_DDS_3
from rocket_sim_node.wire.distributions import FastDds
from rocket_sim_node.wire.distributions import fast_dds
from ros2 import graph
from ros2.main import main

OURS = Path(transport.__file__).parent / 'profiles'
VERSION = fast_dds()[0]
PROFILE = VERSION.variables[0]
"""variable that names a profile"""
RMW = 'rmw_fastrtps_cpp'
RENAMED = {
    'heartbeatPeriod': 'heartbeat_period', 'nackResponseDelay': 'nack_response_delay',
    'heartbeatResponseDelay': 'heartbeat_response_delay'}
"""elements of Fast DDS 2 that Fast DDS 3 names otherwise"""
GOOD = """<?xml version="1.0"?>
<dds xmlns="http://www.eprosima.com">
  <profiles>
    <participant profile_name="mine" is_default_profile="true">
      <rtps>
        <participantID>3</participantID>
      </rtps>
    </participant>
  </profiles>
</dds>
"""
PARTICIPANT = GOOD[GOOD.index('    <participant '):GOOD.index('  </profiles>')]
LISTED = """<transport_descriptors><transport_descriptor>
<transport_id>mine</transport_id><type>UDPv4</type>
<interfaceWhiteList><address>{}</address></interfaceWhiteList>
</transport_descriptor></transport_descriptors><participant """
SENT_TO = """<defaultUnicastLocatorList><locator><udpv4>
<address>{}</address></udpv4></locator></defaultUnicastLocatorList><participantID>"""


@pytest.fixture(autouse=True)
def clean(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No settings of the machine's, in a folder without a profile."""
    for name in (
            transport.RANGE, 'ROS_LOCALHOST_ONLY', 'ROS_STATIC_PEERS', 'ROS_DISCOVERY_SERVER',
            'FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE',
            'FASTDDS_BUILTIN_TRANSPORTS', 'SKIP_DEFAULT_XML_FILE', 'ROS2_EASY_MODE',
            'ROS_SECURITY_ENABLE'):
        monkeypatch.delenv(name, raising=False)
    # The ros2 command sets it where it is not set, and nodes of later tests would inherit it.
    monkeypatch.setenv('ROS_PYTHON_CHECK_FIELDS', '1')
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def schema() -> Path:
    """The schema that came with Fast DDS."""
    path = fast_dds()[1]
    if path is None:
        pytest.skip('no schema of profiles: no Fast DDS')
    return path


def inside(rmw: str = RMW) -> dict[str, str]:
    """Return the environment that a first node is made in."""
    before = dict(os.environ)
    with transport.prepared(rmw):
        found = dict(os.environ)
    assert dict(os.environ) == before
    return found


@pytest.mark.parametrize('name', ['machine.xml', 'network.xml', 'server.xml'])
def test_our_profiles_are_right(name: str, schema: Path) -> None:
    check_profile(VERSION.profiles / name, schema)


@pytest.mark.parametrize('name', ['machine.xml', 'network.xml', 'server.xml'])
def test_both_versions_of_fast_dds_get_the_same_profile(name: str) -> None:
    def content(version: FastDds) -> list[tuple[str, dict[str, str], str]]:
        root = ElementTree.parse(version.profiles / name).getroot()
        return [(RENAMED.get(tag := element.tag.rpartition('}')[2], tag), element.attrib,
                 (element.text or '').strip()) for element in root.iter()]

    assert content(FAST_DDS_2) == content(FAST_DDS_3)


def test_fast_dds_2_finds_its_profile_by_its_own_variable(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / FAST_DDS_2.schema
    path.parent.mkdir()
    path.touch()
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    monkeypatch.setenv(transport.RANGE, 'SUBNET')
    with transport.prepared(RMW):
        assert 'FASTDDS_DEFAULT_PROFILES_FILE' not in os.environ, 'it does not know that one'
        assert os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] == str(
            FAST_DDS_2.profiles / 'network.xml')
    (tmp_path / 'DEFAULT_FASTDDS_PROFILES.xml').touch()
    assert not transport.set_up_by_user()
    (tmp_path / 'DEFAULT_FASTRTPS_PROFILES.xml').touch()
    assert transport.set_up_by_user()


@pytest.mark.parametrize('namespace', [
    'http://www.eprosima.com', 'http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles', None])
def test_good_profiles_pass(namespace: str | None, schema: Path, tmp_path: Path) -> None:
    path = tmp_path / 'mine.xml'
    declared = f' xmlns="{namespace}"' if namespace else ''
    path.write_text(GOOD.replace(' xmlns="http://www.eprosima.com"', declared))
    check_profile(path, schema)


@pytest.mark.parametrize('text', [
    GOOD.replace('<profiles>', '').replace('</profiles>', '').replace('dds', 'profiles'),
    *(GOOD.replace(PARTICIPANT, profiles) for profiles in (
        '<data_writer profile_name="rt/observation"/>',
        '<data_reader profile_name="any" is_default_profile="true"/>',
        '<topic profile_name="any" is_default_profile="true"/>',
        '<participant profile_name="any"/><data_reader profile_name="any"/>',
        f'<participant profile_name="any"/>{PARTICIPANT}')),
    '<dds><log><use_default>FALSE</use_default></log></dds>',
    *(GOOD.replace('<participant ', LISTED.format(address)) for address in (
        '127.0.0.1', '::1', 'fe80::1', 'lo', 'enp0s31f6', 'br-lan', 'eth0.100', 'eth0:1')),
    *(GOOD.replace('<participantID>', SENT_TO.format(address)) for address in (
        '10.0.0.7', '0.0.0.0', 'localhost', 'mars', '3com.example.org')),
])
def test_profiles_that_are_of_use_pass(text: str, schema: Path, tmp_path: Path) -> None:
    path = tmp_path / 'mine.xml'
    path.write_text(text)
    check_profile(path, schema)


@pytest.mark.parametrize(('old', 'new', 'words'), [
    ('</rtps>', '</rtsp>', (':7: no XML', 'rtps', 'rtsp')),
    (GOOD, '', (':1: no XML',)),
    (GOOD, 'participant: 3\n', (':1: no XML',)),
    ('<dds xmlns="http://www.eprosima.com">', '<dds xmlns="http://www.omg.org/dds">',
     (':2: namespace', 'omg', 'http://www.eprosima.com')),
    ('dds', 'fastdds', (':2: ', 'fastdds', 'No matching global declaration')),
    ('<participantID>3</participantID>', '<participantId>3</participantId>',
     (":6: Element 'participantId'", 'Expected is', Path(VERSION.schema).name)),
    ('>3<', '>three<', (":6: Element 'participantID'", "'three'", 'int32')),
    ('>3<', '>${NOBODY_SET_THIS}<', (':6: ${NOBODY_SET_THIS}', 'a variable of the environment')),
    ('<participantID>3</participantID>', '<userTransports><transport_id>udp</transport_id>'
     '</userTransports>', (":6: transport_id 'udp'", 'transport_descriptors', 'there are none')),
    ('profile_name="mine" ', '', (':4: ', 'profile_name')),
    (' is_default_profile="true"', '', (
        ":4: is_default_profile of participant 'mine' is missing, expected true",)),
    ('"true"', '"false"', (":4: is_default_profile of participant 'mine' is false",)),
    ('"true"', '"1"', (":4: is_default_profile of participant 'mine' is 1, expected true",)),
    (f'  <profiles>\n{PARTICIPANT}  </profiles>\n', '', (
        ':2: no profile that ROS 2 uses, expected a participant with is_default_profile="true"',)),
    (PARTICIPANT, LISTED.partition('<participant ')[0].format('lo'), (':2: no profile that',)),
    (PARTICIPANT, '<topic profile_name="any"/>', (':2: no profile that ROS 2 uses',)),
    (PARTICIPANT, f'{PARTICIPANT}<participant profile_name="mine"/>', (
        ":9: participant 'mine', expected another name: there is one in line 4",)),
    (PARTICIPANT, '<data_writer profile_name="a"/>\n<data_reader profile_name="a"/>\n'
     '<data_writer profile_name="a"/>', (
        ":6: data_writer 'a', expected another name: there is one in line 4",)),
    ('<participant ', LISTED.replace('</transport_descriptors>', (
        '<transport_descriptor>\n<transport_id>mine</transport_id><type>SHM</type>'
        '</transport_descriptor></transport_descriptors>')).format('lo'), (
        ":8: transport_descriptor 'mine', expected another name: there is one in line 5",)),
    *(('<participant ', LISTED.format(address), (
        f':6: address {address!r}, expected an IP address or the name of an interface',))
      for address in (
        '999.1.2.3', '127.0.0', '127.0.0.1.', '10.0.0.0/24', '10.0.0.*', '127.0.0.1:7400',
        ' 127.0.0.1', '12::34::56', '*')),
    *(('<participantID>', SENT_TO.format(address), (
        f':7: address {address!r}, expected an IPv4 address or the name of a host',))
      for address in ('999.1.2.3', '256.0.0.1', '::1', 'mars:7400', 'no host', '-.-')),
])
def test_bad_profiles_are_named(
        old: str, new: str, words: tuple[str, ...], schema: Path, tmp_path: Path) -> None:
    path = tmp_path / 'mine.xml'
    assert old in GOOD
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(ProfileError) as caught:
        check_profile(path, schema)
    for word in (str(path), *words):
        assert word in str(caught.value), caught.value


@pytest.mark.parametrize('make', [Path.mkdir, None])
def test_a_profile_that_is_not_a_file_is_named(make: object, schema: Path, tmp_path: Path) -> None:
    path = tmp_path / 'mine.xml'
    if callable(make):
        make(path)
    with pytest.raises(ProfileError, match=r'mine\.xml: .*expected a(n XML| regular file)'):
        check_profile(path, schema)


def test_this_machine_is_the_default_and_other_transports_are_left_alone() -> None:
    assert transport.discovery_range() == 'LOCALHOST'
    assert not transport.beyond_machine()
    found = inside('rmw_cyclonedds_cpp')
    assert found[transport.RANGE] == 'LOCALHOST'
    assert PROFILE not in found


@pytest.mark.parametrize(('name', 'value', 'profile', 'beyond'), [
    ('ROS_LOCALHOST_ONLY', '1', 'machine.xml', False),
    (transport.RANGE, 'LOCALHOST', 'machine.xml', False),
    (transport.RANGE, '', 'machine.xml', False),
    (transport.RANGE, 'OFF', 'machine.xml', False),
    (transport.RANGE, 'SUBNET', 'network.xml', True),
    (transport.RANGE, 'SYSTEM_DEFAULT', 'network.xml', True),
    ('ROS_STATIC_PEERS', '10.0.0.7', 'network.xml', True),
])
def test_the_discovery_range_selects_the_profile(
        name: str, value: str, profile: str, beyond: bool, schema: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(name, value)
    assert transport.beyond_machine() == beyond
    found = inside()
    assert found[PROFILE] == str(VERSION.profiles / profile)


@pytest.mark.parametrize(('name', 'value'), [
    ('ROS_LOCALHOST_ONLY', '1'), (transport.RANGE, 'OFF')])
def test_static_peers_are_ignored_without_discovery_of_others(
        name: str, value: str, schema: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_STATIC_PEERS', '10.0.0.7')
    monkeypatch.setenv(name, value)
    assert not transport.beyond_machine()
    assert inside()[PROFILE] == str(VERSION.profiles / 'machine.xml')


def test_user_settings_of_fast_dds_take_precedence(
        schema: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = tmp_path / 'mine.xml'
    mine.write_text(GOOD)
    for name, server in itertools.product(VERSION.variables, ('', '127.0.0.1:11811')):
        with monkeypatch.context() as patch:
            patch.setenv(name, str(mine))
            patch.setenv('ROS_DISCOVERY_SERVER', server)
            found = inside()
        assert found[name] == str(mine)
        assert found[transport.RANGE] == 'LOCALHOST'
        assert OURS not in Path(found.get(PROFILE, '/')).parents
    mine.rename(tmp_path / VERSION.default)
    assert PROFILE not in inside()
    monkeypatch.setenv('SKIP_DEFAULT_XML_FILE', '1')
    assert OURS in Path(inside()[PROFILE]).parents


@pytest.mark.parametrize('wider', ['', 'SUBNET'])
def test_with_a_discovery_server_only_the_number_of_nodes_is_ours(
        wider: str, schema: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_DISCOVERY_SERVER', '192.0.2.7:11811')
    monkeypatch.setenv(transport.RANGE, wider)
    found = inside()
    assert found['ROS_DISCOVERY_SERVER'] == '192.0.2.7:11811'
    assert found[PROFILE] == str(VERSION.profiles / 'server.xml')
    assert found[transport.RANGE] == (wider or 'LOCALHOST')
    assert transport.set_up_by_user()


@pytest.mark.parametrize('name', [PROFILE, None])
def test_nothing_starts_with_a_bad_profile(
        name: str | None, schema: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = tmp_path / (f'{name}.xml' if name else VERSION.default)
    mine.write_text(GOOD.replace('>3<', '>three<'))
    if name:
        monkeypatch.setenv(name, str(mine))
    with pytest.raises(ProfileError, match='three'):
        inside()


@pytest.mark.parametrize(('name', 'value', 'words'), [
    (PROFILE, 'mine.xml', 'mine.xml:6: '),
    (transport.RANGE, 'localhost', f"{transport.RANGE}: got 'localhost'"),
    ('ROS_SECURITY_ENABLE', '1', "ROS_SECURITY_ENABLE is '1', expected true or false"),
])
@pytest.mark.parametrize('argv', [
    ['topic', 'list'], ['node', 'list'], ['action', 'list'],
    ['param', 'get', '/simulator', 'seed'],
    ['service', 'call', '/simulator/reset', 'rcl_interfaces/srv/GetParameters']])
def test_the_ros2_command_refuses_what_nodes_refuse(
        argv: list[str], name: str, value: str, words: str, schema: Path, tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / 'mine.xml').write_text(GOOD.replace('>3<', '>three<'))
    monkeypatch.setenv(name, value)
    monkeypatch.setattr(graph, 'get_rmw_implementation_identifier', lambda: RMW)
    monkeypatch.setattr(graph.rclpy, 'init', Mock(side_effect=AssertionError))
    with pytest.raises(SystemExit) as ended:
        main(argv)
    assert ended.value.code == 2
    printed, = capsys.readouterr().err.splitlines()
    assert printed.startswith(f'ros2: {words}')


def test_the_ros2_command_is_bound_as_nodes_are(
        schema: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    profiles = []

    def create_node(*args: object, **options: object) -> Mock:
        profiles.append(Path(os.environ[PROFILE]))
        return Mock()

    monkeypatch.setattr(graph, 'get_rmw_implementation_identifier', lambda: RMW)
    monkeypatch.setattr(graph.rclpy, 'init', lambda **options: None)
    monkeypatch.setattr(graph.rclpy, 'try_shutdown', lambda context: None)
    monkeypatch.setattr(graph.rclpy, 'create_node', create_node)
    with graph.direct_node():
        assert PROFILE not in os.environ
    (profile,) = profiles
    assert profile == VERSION.profiles / 'machine.xml'


def test_the_largest_receive_buffer_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    sockets = transport._udp_sockets
    # Other tests' nodes may have sockets as well.
    others = {descriptor for descriptor, *_ in transport._udp_sockets()}
    monkeypatch.setattr(transport, '_udp_sockets', lambda: (
        found for found in list(sockets()) if found[0] not in others))
    assert transport.receive_buffer() is None
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 50_000)
        probe.bind(('127.0.0.1', 0))
        probe.setblocking(True)
        socket.setdefaulttimeout(9.0)
        try:
            assert transport.receive_buffer() == 50_000
            assert socket.getdefaulttimeout() == 9.0
        finally:
            socket.setdefaulttimeout(None)
        assert probe.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) == 100_000, 'still open'
        assert os.get_blocking(probe.fileno())


def test_a_socket_that_the_network_reaches_is_an_error(schema: Path) -> None:
    before = set(transport.open_ports())  # of other tests' nodes
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        with transport.prepared(RMW):
            probe.bind(('127.0.0.1', 0))
        assert set(transport.open_ports()) == before
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        with (pytest.raises(transport.TransportError, match=r'udp port .*machine\.xml'),
              transport.prepared(RMW)):
            probe.bind(('', 0))
        (found,) = set(transport.open_ports()) - before
        assert f'port {probe.getsockname()[1]} ' in found
        with transport.prepared(RMW):  # which was there before
            pass


def test_user_settings_that_the_network_reaches_are_reported(
        schema: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4')
    for address, wider, warnings in (('', '', 1), ('127.0.0.1', '', 0), ('', 'SUBNET', 0)):
        with (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe,
              monkeypatch.context() as patch):
            patch.setenv(transport.RANGE, wider)
            with transport.prepared(RMW):
                probe.bind((address, 0))
        said = ''.join(capfd.readouterr())
        assert said.count('it may receive from other machines') == warnings, said


@pytest.mark.parametrize(('rmw', 'address', 'wider', 'warnings'), [
    (RMW, '', '', 1), ('rmw_fastrtps_dynamic_cpp', '', 'LOCALHOST', 1), (RMW, '', 'OFF', 1),
    (RMW, '127.0.0.1', '', 0), (RMW, '', 'SUBNET', 0), ('rmw_cyclonedds_cpp', '', '', 0)])
@pytest.mark.parametrize('own', [True, False])
def test_ports_that_the_network_reaches_are_reported_without_a_schema(
        rmw: str, address: str, wider: str, warnings: int, own: bool,
        monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(transport, 'fast_dds', lambda: (VERSION, None))
    monkeypatch.setenv(transport.RANGE, wider)
    if own:
        monkeypatch.setenv('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4')
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        with transport.prepared(rmw):
            assert PROFILE not in os.environ
            probe.bind((address, 0))
        port = probe.getsockname()[1]
    said = ''.join(capfd.readouterr())
    assert said.count('it may receive from other machines') == warnings, said
    assert said.count(f'Fast DDS listens on udp port {port} ') == warnings, said


@pytest.mark.parametrize(('rmw', 'warnings'), [(RMW, 1), ('rmw_cyclonedds_cpp', 0)])
def test_a_profile_without_a_schema_is_reported_and_not_checked(
        rmw: str, warnings: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(transport, 'fast_dds', lambda: (VERSION, None))
    mine = tmp_path / 'mine.xml'
    mine.write_text(GOOD.replace('>3<', '>three<'))
    monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(mine))
    assert inside(rmw)['FASTRTPS_DEFAULT_PROFILES_FILE'] == str(mine)
    said = ''.join(capfd.readouterr())
    assert said.count(f'{mine} is not checked') == warnings, said


def test_a_profile_at_the_default_path_counts_as_a_user_setting(
        schema: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not transport.set_up_by_user()
    (tmp_path / VERSION.default).write_text(GOOD)
    assert transport.set_up_by_user()
    monkeypatch.setenv('SKIP_DEFAULT_XML_FILE', '1')
    assert not transport.set_up_by_user()


def test_an_invalid_range_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(transport.RANGE, 'localhost')
    with pytest.raises(transport.TransportError, match=f"{transport.RANGE}: got 'localhost'"):
        inside()
