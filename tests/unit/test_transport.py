# SPDX-License-Identifier: Apache-2.0
"""What Fast DDS is told: our profiles, a user's, and the environment while a node starts."""
from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from rocket_sim_node.wire import transport
from rocket_sim_node.wire.dds_profile import ProfileError
from rocket_sim_node.wire.dds_profile import check_profile
from rocket_sim_node.wire.dds_profile import schema_path
from rocket_sim_node.wire.transport import SharedMemory

OURS = Path(transport.__file__).parent / 'profiles'
RMW = 'rmw_fastrtps_cpp'
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


@pytest.fixture(autouse=True)
def clean(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No settings of the machine's, in a folder without a profile."""
    for name in (
            transport.RANGE, 'ROS_LOCALHOST_ONLY', 'ROS_STATIC_PEERS', 'ROS_DISCOVERY_SERVER',
            'FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE',
            'FASTDDS_BUILTIN_TRANSPORTS', 'SKIP_DEFAULT_XML_FILE', 'ROS2_EASY_MODE'):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def schema() -> Path:
    """The schema that came with Fast DDS."""
    path = schema_path()
    if path is None:
        pytest.skip('no schema of profiles: not Fast DDS 3')
    return path


def inside(rmw: str = RMW) -> dict[str, str]:
    """Return the environment that a first node is made in."""
    before = dict(os.environ)
    with transport.prepared(rmw):
        found = dict(os.environ)
    assert dict(os.environ) == before
    return found


@pytest.mark.parametrize('name', ['machine.xml', 'network.xml'])
def test_our_profiles_are_right(
        name: str, schema: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('HOVERSLAM_DATA_PORT_OFFSET', '7')
    check_profile(OURS / name, schema)


@pytest.mark.parametrize(('reach', 'udp'), [
    ('LOCALHOST', '<udpv4><address>127.0.0.1</address></udpv4>'), ('SUBNET', '<udpv4></udpv4>')])
@pytest.mark.parametrize('use', [SharedMemory.TO_SEND, SharedMemory.NEVER])
def test_who_uses_shared_memory_less_has_a_profile_of_its_own(
        use: SharedMemory, reach: str, udp: str, schema: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(transport.RANGE, reach)
    with transport.prepared(RMW, use):
        path = Path(os.environ['FASTDDS_DEFAULT_PROFILES_FILE'])
        check_profile(path, schema)
        participant = path.read_text('utf-8').partition('<participant ')[2]
    transports = participant.partition('<userTransports>')[2].partition('</userTransports>')[0]
    heard = participant.partition('<defaultUnicastLocatorList>')[2].partition('</default')[0]
    sends = use is SharedMemory.TO_SEND
    assert ('shared_memory' in transports) == sends
    assert transports.count('<transport_id>') == 1 + sends
    assert heard.split() == ([f'<locator>{udp}</locator>'] if sends else [])
    assert not path.exists()
    assert path.parent == Path('/proc/self/fd'), 'a full disk keeps nobody from starting'


@pytest.mark.parametrize('namespace', [
    'http://www.eprosima.com', 'http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles', None])
def test_good_profiles_pass(namespace: str | None, schema: Path, tmp_path: Path) -> None:
    path = tmp_path / 'mine.xml'
    declared = f' xmlns="{namespace}"' if namespace else ''
    path.write_text(GOOD.replace(' xmlns="http://www.eprosima.com"', declared))
    check_profile(path, schema)


@pytest.mark.parametrize(('old', 'new', 'words'), [
    ('</rtps>', '</rtsp>', (':7: no XML', 'rtps', 'rtsp')),
    (GOOD, '', (':1: no XML',)),
    (GOOD, 'participant: 3\n', (':1: no XML',)),
    ('<dds xmlns="http://www.eprosima.com">', '<dds xmlns="http://www.omg.org/dds">',
     (':2: namespace', 'omg', 'http://www.eprosima.com')),
    ('dds', 'fastdds', (':2: ', 'fastdds', 'No matching global declaration')),
    ('<participantID>3</participantID>', '<participantId>3</participantId>',
     (":6: Element 'participantId'", 'Expected is', 'fastdds_profiles.xsd')),
    ('>3<', '>three<', (":6: Element 'participantID'", "'three'", 'int32')),
    ('>3<', '>${NOBODY_SET_THIS}<', (':6: ${NOBODY_SET_THIS}', 'a variable of the environment')),
    ('<participantID>3</participantID>', '<userTransports><transport_id>udp</transport_id>'
     '</userTransports>', (":6: transport_id 'udp'", 'transport_descriptors', 'there are none')),
    ('profile_name="mine" ', '', (':4: ', 'profile_name')),
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
def test_what_is_no_file_is_named(make: object, schema: Path, tmp_path: Path) -> None:
    path = tmp_path / 'mine.xml'
    if callable(make):
        make(path)
    with pytest.raises(ProfileError, match=r'mine\.xml: .*expected an XML profile'):
        check_profile(path, schema)


def test_this_machine_is_the_default_and_other_transports_are_left_alone() -> None:
    assert transport.discovery_range() == 'LOCALHOST'
    assert not transport.beyond_machine()
    found = inside('rmw_cyclonedds_cpp')
    assert found[transport.RANGE] == 'LOCALHOST'
    assert 'FASTDDS_DEFAULT_PROFILES_FILE' not in found


@pytest.mark.parametrize(('name', 'value', 'profile', 'beyond'), [
    ('ROS_LOCALHOST_ONLY', '1', 'machine.xml', False),
    (transport.RANGE, 'LOCALHOST', 'machine.xml', False),
    (transport.RANGE, '', 'machine.xml', False),
    (transport.RANGE, 'OFF', 'machine.xml', False),
    (transport.RANGE, 'SUBNET', 'network.xml', True),
    (transport.RANGE, 'SYSTEM_DEFAULT', 'network.xml', True),
    ('ROS_STATIC_PEERS', '10.0.0.7', 'network.xml', True),
])
def test_the_range_decides(
        name: str, value: str, profile: str, beyond: bool, schema: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(name, value)
    assert transport.beyond_machine() == beyond
    found = inside()
    assert found['FASTDDS_DEFAULT_PROFILES_FILE'] == str(OURS / profile)
    assert 0 < int(found['HOVERSLAM_DATA_PORT_OFFSET']) < 2**16


@pytest.mark.parametrize(('name', 'value'), [
    ('ROS_LOCALHOST_ONLY', '1'), (transport.RANGE, 'OFF')])
def test_who_wants_nobody_gets_nobody_by_name_either(
        name: str, value: str, schema: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_STATIC_PEERS', '10.0.0.7')
    monkeypatch.setenv(name, value)
    assert not transport.beyond_machine()
    assert inside()['FASTDDS_DEFAULT_PROFILES_FILE'] == str(OURS / 'machine.xml')


def test_who_sets_up_fast_dds_has_the_word(
        schema: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = tmp_path / 'mine.xml'
    mine.write_text(GOOD)
    for name, value in (
            ('FASTDDS_DEFAULT_PROFILES_FILE', str(mine)),
            ('FASTRTPS_DEFAULT_PROFILES_FILE', str(mine)),
            ('ROS_DISCOVERY_SERVER', '127.0.0.1:11811')):
        with monkeypatch.context() as patch:
            patch.setenv(name, value)
            found = inside()
        assert found[name] == value
        assert found[transport.RANGE] == 'LOCALHOST'
        assert 'HOVERSLAM_DATA_PORT_OFFSET' not in found
    mine.rename(tmp_path / 'DEFAULT_FASTDDS_PROFILES.xml')
    assert 'HOVERSLAM_DATA_PORT_OFFSET' not in inside()
    monkeypatch.setenv('SKIP_DEFAULT_XML_FILE', '1')
    assert 'HOVERSLAM_DATA_PORT_OFFSET' in inside()


@pytest.mark.parametrize('name', ['FASTDDS_DEFAULT_PROFILES_FILE', None])
def test_nothing_starts_with_a_bad_profile(
        name: str | None, schema: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = tmp_path / (f'{name}.xml' if name else 'DEFAULT_FASTDDS_PROFILES.xml')
    mine.write_text(GOOD.replace('>3<', '>three<'))
    if name:
        monkeypatch.setenv(name, str(mine))
    with pytest.raises(ProfileError, match='three'):
        inside()


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


def test_a_set_up_of_ones_own_that_the_network_reaches_is_told(
        schema: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4')
    for address, wider, told in (('', '', 1), ('127.0.0.1', '', 0), ('', 'SUBNET', 0)):
        with (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe,
              monkeypatch.context() as patch):
            patch.setenv(transport.RANGE, wider)
            with transport.prepared(RMW):
                probe.bind((address, 0))
        said = ''.join(capfd.readouterr())
        assert said.count('others than this machine may be heard') == told, said


def test_profiles_that_lie_where_fast_dds_looks_count_as_set_up(
        schema: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not transport.set_up_by_user()
    (tmp_path / 'DEFAULT_FASTDDS_PROFILES.xml').write_text(GOOD)
    assert transport.set_up_by_user()
    monkeypatch.setenv('SKIP_DEFAULT_XML_FILE', '1')
    assert not transport.set_up_by_user()


def test_a_range_that_is_none_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(transport.RANGE, 'localhost')
    with pytest.raises(transport.TransportError, match=f"{transport.RANGE}: got 'localhost'"):
        inside()


@pytest.mark.parametrize('domain', [0, 42, 101, 230, 232])
def test_starts_have_data_ports_of_their_own(domain: int) -> None:
    first = 7400 + 250 * domain
    ports = [first + transport.fresh_data_offset(domain) for _ in range(100)]
    assert max(ports) < 2**16 - 250 or domain > 230
    if domain <= 101:
        assert min(ports) >= max(32768, first + 250)
        assert len(set(ports)) > 90
