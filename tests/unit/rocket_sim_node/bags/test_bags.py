# SPDX-License-Identifier: Apache-2.0
"""Bags: other programs read them, and flights are read back bit for bit."""
from __future__ import annotations

import errno
import os
import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from mcap.records import Channel
from mcap.records import Message
from mcap.records import Schema
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from rocket_msgs import msg
from rosbags.highlevel import AnyReader
from support.recording.bags import flight_messages
from support.recording.bags import serialized
from support.recording.bags import topic_of
from support.recording.bags import write
from support.recording.bags import write_records
from tf2_msgs.msg import TFMessage

from rocket_sim_node.bags import bag_file
from rocket_sim_node.bags import definitions
from rocket_sim_node.bags import mcap_file
from rocket_sim_node.bags.bag_file import BagFile
from rocket_sim_node.bags.decoder import Decoder
from rocket_sim_node.bags.metadata import Quality
from rocket_sim_node.bags.metadata import Topic
from rocket_sim_node.bags.missed_messages import counter_of
from rocket_sim_node.bags.reader import files_of
from rocket_sim_node.bags.reader import messages
from rocket_sim_node.bags.reader import read
from rocket_sim_node.bags.to_rerun import main as to_rerun
from rocket_sim_node.recording import reader as recordings
from rocket_sim_node.recording.drawing.training_plots import LINES
from rocket_sim_node.recording.sinks.rrd_file import opened
from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.samples import samples_of

STEPS = 399


def assert_same(found: Any, message: msg.RocketState) -> None:
    """Compare all fields of a state; between them, serialized messages hold random bytes."""
    header, expected = found.header, message.header
    assert (header.stamp.sec, header.stamp.nanosec, header.frame_id) == (
        expected.stamp.sec, expected.stamp.nanosec, 'world')
    for name in message.get_fields_and_field_types().keys() - {'header'}:
        np.testing.assert_array_equal(getattr(found, name), getattr(message, name), name)


class Notes(list[tuple[str, str]]):
    """Texts of the notes."""

    def __call__(self, level: str, text: str) -> None:
        self.append((level, text))

    @property
    def text(self) -> str:
        return '\n'.join(text for _, text in self)


@pytest.fixture
def notes() -> Notes:
    return Notes()


@pytest.fixture
def make_bag(tmp_path: Path, notes: Notes) -> Callable[..., BagFile]:
    return lambda name='bag', **options: BagFile(tmp_path / name, notes, **options)


@pytest.mark.parametrize('compression', ['zstd', 'none'])
def test_an_independent_reader_finds_every_message(
    make_bag: Callable[..., BagFile], tmp_path: Path, compression: str,
) -> None:
    said = flight_messages('rocket', 2, STEPS)
    bag = make_bag(compression=compression)
    write(bag, said)
    bag.close()
    assert sorted(file.name for file in (tmp_path / 'bag').iterdir()) == [
        'bag_0.mcap', 'metadata.yaml']
    with AnyReader([tmp_path / 'bag']) as found:
        assert found.message_count == len(said)
        assert {one.topic: (one.msgtype, one.digest) for one in found.connections} == {
            f'/{name}': (f'rocket_msgs/msg/{kind}', definitions.type_hash(
                f'rocket_msgs/msg/{kind}'))
            for name, kind in (('world', 'World'), ('state', 'RocketState'))}
        for one in found.connections:  # computed by that library from the definition in the bag
            assert found.typestore.hash_rihs01(one.msgtype) == one.digest
        steps = []
        for (connection, time, raw), message in zip(found.messages(), said, strict=True):
            decoded: Any = found.deserialize(raw, connection.msgtype)
            if connection.topic == '/state':
                assert_same(decoded, message)
                steps += decoded.step.tolist()
            assert time == 1_000_000_000 + said.index(
                message) * 20_000_000
        assert sorted(set(steps)) == list(range(STEPS + 1))


def test_metadata_is_that_of_rosbag2(make_bag: Callable[..., BagFile], tmp_path: Path) -> None:
    bag = make_bag(distribution='kilted')
    write(bag, flight_messages('rocket', 1, 49))
    bag.tell('/state', '3 steps were not received')
    bag.close()
    found = yaml.safe_load((tmp_path / 'bag/metadata.yaml').read_text())[
        'rosbag2_bagfile_information']
    assert found['version'] == 9
    assert found['storage_identifier'] == 'mcap'
    assert found['relative_file_paths'] == ['bag_0.mcap']
    assert found['message_count'] == 3
    assert found['duration'] == {'nanoseconds': 40_000_000}
    assert found['starting_time'] == {'nanoseconds_since_epoch': 1_000_000_000}
    assert found['ros_distro'] == 'kilted'
    assert found['custom_data'] == {'/state': '3 steps were not received'}
    world = found['topics_with_message_count'][0]
    assert world['message_count'] == 1
    assert world['topic_metadata']['type_description_hash'].startswith('RIHS01_')
    quality = world['topic_metadata']['offered_qos_profiles'][0]
    assert (quality['durability'], quality['depth']) == ('transient_local', 1)


@pytest.mark.parametrize('world', ['rocket', 'lunar_lander'])
def test_flights_are_read_back_bit_for_bit(
    make_bag: Callable[..., BagFile], tmp_path: Path, world: str,
) -> None:
    said = flight_messages(world, 2, STEPS)
    bag = make_bag()
    write(bag, said, '/sim_0')
    bag.close()
    flights = read(tmp_path / 'bag')
    states = [samples_of(message) for message in said[1:]]
    values = np.concatenate([one.values for one in states])
    row = np.concatenate([one.row for one in states])
    episode = np.concatenate([one.episode for one in states])
    assert flights
    assert flights[0].outcome in ('too_fast', 'crashed', 'off_pad', 'tipped', 'tilt_limit',
                                  'out_of_bounds')
    for flight in flights:
        mine = values[(row == flight.row) & (episode == flight.episode)]
        np.testing.assert_array_equal(flight.values, mine)
    assert sum(map(len, flights)) == len(values)
    assert [flight.row for flight in read(tmp_path / 'bag', rows=[1])] == [
        flight.row for flight in flights if flight.row == 1]
    assert len(read(tmp_path / 'bag/bag_0.mcap', topic='/sim_0/state')) == len(flights)
    assert read(tmp_path / 'bag', topic='/sim_1/state') == []


def test_a_bag_of_two_simulators_needs_a_topic(
        make_bag: Callable[..., BagFile], tmp_path: Path) -> None:
    bag = make_bag()
    for space in ('/sim_0', '/sim_1'):
        write(bag, flight_messages('rocket', 1, 24), space)
    bag.close()
    with pytest.raises(ValueError, match='topic: there are /sim_0/state and /sim_1/state'):
        read(tmp_path / 'bag')


def test_a_flight_with_missing_steps_is_left_out(
        make_bag: Callable[..., BagFile], tmp_path: Path) -> None:
    said = flight_messages('rocket', 1, 699)
    bag = make_bag()
    write(bag, said[:5] + said[6:])
    bag.close()
    whole = read(tmp_path / 'bag')
    assert 0 not in {flight.episode for flight in whole}
    assert 1 in {flight.episode for flight in whole}


def test_a_recording_made_of_a_bag(
    make_bag: Callable[..., BagFile], tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    bag = make_bag()
    said = flight_messages('rocket', 2, STEPS)
    write(bag, said)
    write(bag, [msg.TrainingStatus(run='run', stage='evaluate', iteration=1)], at=9_000_000_000)
    bag.close()
    assert to_rerun([str(tmp_path / 'bag'), str(tmp_path / 'run.rrd')]) == 0
    flights = [flight for flight in read(tmp_path / 'bag') if flight.outcome]
    recorded = recordings.trajectories(tmp_path / 'run.rrd')
    assert len(recorded) == len(flights) == 2
    for flight, found in zip(flights, recorded, strict=True):
        assert (found.row, found.outcome) == (flight.row, flight.outcome)
        np.testing.assert_array_equal(
            found.position[:len(flight)], flight.position.astype(np.float32))
    assert '2 flights' in capsys.readouterr().err


def test_rerun_shows_transforms_of_a_bag(
    make_bag: Callable[..., BagFile], tmp_path: Path,
) -> None:
    bag = make_bag()
    name = 'tf2_msgs/msg/TFMessage'
    bag.add_topic(Topic('/tf', name, definitions.type_hash(name)))
    for k in range(3):
        moved = TransformStamped(child_frame_id='rocket_0/base_link')
        moved.header.frame_id = 'world'
        moved.header.stamp.sec = k
        moved.transform.translation.z = 100.0 - k
        bag.write('/tf', bytes(serialize_message(TFMessage(transforms=[moved]))), 10**9, 10**9)
    bag.close()
    subprocess.run(
        ['rerun', 'mcap', 'convert', str(tmp_path / 'bag/bag_0.mcap'), '-o',
         str(tmp_path / 'tf.rrd')], check=True, capture_output=True, timeout=60)
    heights = [
        row[0][2] for chunk in opened(tmp_path / 'tf.rrd').stream()
        for batch in [chunk.to_record_batch()] if 'Transform3D:translation' in batch.schema.names
        for row in batch.column('Transform3D:translation').to_pylist() if row]
    assert heights == [100.0, 99.0, 98.0]


@pytest.mark.parametrize('what', ['nothing', 'a text', 'a folder'])
def test_error_names_a_file_that_is_not_a_bag(
    tmp_path: Path, what: str, capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / 'it.mcap'
    if what == 'a text':
        path.write_text('no bag')
    elif what == 'a folder':
        path.mkdir()
    with pytest.raises(ValueError, match=re.escape(str(path))):
        read(path)
    assert to_rerun([str(path)]) == 2
    assert str(path) in capsys.readouterr().err


BOMB = 'a0: &a0 [lol, lol]\n' + ''.join(
    f'a{n}: &a{n} [{", ".join(9 * [f"*a{n - 1}"])}]\n' for n in range(1, 9))
"""a few hundred bytes, which would be hundreds of megabytes if they were written out"""


@pytest.mark.parametrize(('old', 'new'), [
    ('rosbag2_bagfile_information:', f'{BOMB}rosbag2_bagfile_information:'),
    ('mcap\n', f'{"[" * 5_000}\n'), ('mcap\n', 'sqlite3\n'), ('mcap\n', '[mcap]\n'),
    ('- bag_0.mcap', '- 7'), ('- bag_0.mcap', 'bag_0.mcap'),
    ('nanoseconds_since_epoch: ', 'nanoseconds_since_epoch: 9999999999'),
    ('nanoseconds_since_epoch: ', 'nanoseconds_since_epoch: -'),
    ('message_count: ', 'message_count: many '), ('topics_with_message_count:', 'topics:')])
def test_invalid_metadata_is_refused_by_name(
    make_bag: Callable[..., BagFile], tmp_path: Path, old: str, new: str,
) -> None:
    bag = make_bag()
    write(bag, flight_messages('rocket', 1, 3))
    bag.close()
    metadata = tmp_path / 'bag/metadata.yaml'
    text = metadata.read_text()
    assert old in text
    metadata.write_text(text.replace(old, new, 1))
    with pytest.raises(ValueError, match=re.escape(str(metadata))) as refused:
        files_of(tmp_path / 'bag')
    assert len(str(refused.value)) < 500


def test_a_fifo_in_a_bag_is_refused(make_bag: Callable[..., BagFile], tmp_path: Path) -> None:
    bag = make_bag()
    write(bag, flight_messages('rocket', 1, 3))
    bag.close()
    file = tmp_path / 'bag/bag_0.mcap'
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(ValueError, match=f'{re.escape(str(file))}: got a FIFO'):
        files_of(tmp_path / 'bag')


def test_damaged_bags_are_named_and_salvaged(
    make_bag: Callable[..., BagFile], tmp_path: Path,
) -> None:
    bag = make_bag()
    write(bag, flight_messages('rocket', 1, 99))
    bag.close()
    path = tmp_path / 'bag/bag_0.mcap'
    whole = path.read_bytes()
    random = np.random.default_rng(5)
    named = 0
    for _ in range(150):
        data = bytearray(whole)
        for place in random.integers(0, len(data), 3):
            data[place] ^= int(random.integers(1, 256))
        path.write_bytes(data)
        try:
            assert len(read(tmp_path / 'bag')) <= 1
        except ValueError as error:
            assert str(path) in str(error) or 'values' in str(error)
            named += 1
        assert len(list(bag_file.Salvage(path))) <= 5
    assert named > 75


@pytest.mark.parametrize('part', [0.3, 0.7, 0.999])
def test_a_killed_recorders_bag_is_repaired(
    make_bag: Callable[..., BagFile], tmp_path: Path, notes: Notes, part: float,
) -> None:
    said = flight_messages('rocket', 1, STEPS)
    bag = make_bag()
    for number, message in enumerate(said):
        write(bag, [message], at=(number + 1) * 20_000_000)
        bag._writer.flush()
    (partial,) = tmp_path.glob('bag.partial/*.mcap')
    size = partial.stat().st_size
    os.close(bag._lock)  # as the end of its process does
    with partial.open('r+b') as file:
        file.truncate(int(part * size))
    again = make_bag()
    assert 'its bag is repaired' in notes.text
    with AnyReader([tmp_path / 'bag']) as found:
        assert len(said) * (part - 0.2) < found.message_count < len(said)
        for (connection, _, raw), message in zip(found.messages(), said, strict=False):
            if connection.topic == '/state':
                assert_same(found.deserialize(raw, connection.msgtype), message)
    write(again, said)
    again.close()
    with AnyReader([tmp_path / 'bag-2']) as found:
        assert found.message_count == len(said)
    assert not list(tmp_path.glob('*.partial'))


def test_an_interrupted_repair_is_done_again(
    make_bag: Callable[..., BagFile], tmp_path: Path, notes: Notes,
) -> None:
    said = flight_messages('rocket', 1, STEPS)
    bag = make_bag()
    write(bag, said)
    bag._writer.flush()
    os.close(bag._lock)
    (partial,) = tmp_path.glob('bag.partial/*.mcap')
    partial.rename(partial.with_suffix('.broken'))
    partial.write_bytes(b'half of the repaired one')
    make_bag().close()
    assert 'its bag is repaired' in notes.text
    with AnyReader([tmp_path / 'bag']) as found:
        assert found.message_count == len(said)
    assert sorted(file.name for file in (tmp_path / 'bag').iterdir()) == [
        'bag_0.mcap', 'metadata.yaml']


def killed(bag: BagFile, said: list[Any]) -> Path:
    """Write messages, each in its own chunk, as a recorder that is killed; return the file."""
    for number, message in enumerate(said):
        write(bag, [message], at=(number + 1) * 20_000_000)
        bag._writer.flush()
    os.close(bag._lock)  # as the end of its process does
    return bag._file


@pytest.mark.parametrize('error', [OSError(errno.EIO, 'Input/output error'), MemoryError()])
def test_a_repair_that_cannot_read_the_bag_deletes_nothing(
    make_bag: Callable[..., BagFile], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    error: Exception,
) -> None:
    said = flight_messages('rocket', 1, STEPS)
    whole = killed(make_bag(), said).read_bytes()
    unpacked, chunks = mcap_file.unpacked, 0

    def fail(chunk: Any) -> Any:
        nonlocal chunks
        chunks += 1
        if chunks > 3:
            raise error
        return unpacked(chunk)

    with monkeypatch.context() as patch:
        patch.setattr(mcap_file, 'unpacked', fail)
        with pytest.raises(OSError, match=r'not repaired yet: .*bag_0\.broken'):
            make_bag()
    assert (tmp_path / 'bag.partial/bag_0.broken').read_bytes() == whole
    make_bag().close()
    with AnyReader([tmp_path / 'bag']) as found:
        assert found.message_count == len(said)


@pytest.mark.parametrize('what', ['content', 'length', 'short length', 'everything'])
def test_a_damaged_bag_of_a_killed_recorder_is_kept(
    make_bag: Callable[..., BagFile], tmp_path: Path, notes: Notes, what: str,
) -> None:
    said = flight_messages('rocket', 1, STEPS)
    file = killed(make_bag(), said)
    data = bytearray(file.read_bytes())
    places = []  # of the chunks
    place = 8
    while place < len(data):
        if data[place] == 6:
            places.append(place)
        place += 9 + int.from_bytes(data[place + 1:place + 9], 'little')
    begin = {'everything': 0}.get(what, places[4])
    if what == 'length':
        data[begin + 5] = 1  # 4 GiB
    elif what == 'short length':
        data[begin + 3] ^= 1  # by 64 KiB
    else:
        data[begin + 60:begin + 70] = bytes(10)
        data[0] ^= what == 'everything'
    file.write_bytes(data)
    make_bag().close()
    assert (tmp_path / 'bag.damaged.mcap').read_bytes() == data
    assert f'its bag is damaged at byte {begin} of {len(data)}; the whole file is kept as' in (
        notes.text)
    assert 'before it received anything' not in notes.text
    if what == 'everything':
        assert [path.name for path in tmp_path.iterdir()] == ['bag.damaged.mcap']
        return
    with AnyReader([tmp_path / 'bag']) as found:
        assert found.message_count == 4
    assert f'damaged at byte {begin}' in (tmp_path / 'bag/metadata.yaml').read_text()


@pytest.mark.parametrize(('number', 'words'), [
    (errno.EWOULDBLOCK, 'another recorder writes this bag'),
    (errno.ENOLCK, 'cannot be locked: No locks available')])
def test_only_a_taken_lock_is_that_of_another_recorder(
    make_bag: Callable[..., BagFile], monkeypatch: pytest.MonkeyPatch, number: int, words: str,
) -> None:
    def refuse(lock: int, how: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(bag_file.fcntl, 'flock', refuse)
    with pytest.raises(OSError, match=words):
        make_bag()


def test_a_lock_that_cannot_be_taken_again_after_a_repair_is_named(
    make_bag: Callable[..., BagFile], monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its own error shows, and none of a lock that was closed twice."""
    killed(make_bag(), flight_messages('rocket', 1, STEPS))
    take, taken = BagFile._take, []

    def once(bag: BagFile) -> int:
        if taken:
            raise OSError(errno.ENOLCK, 'No locks available')
        taken.append(bag)
        return take(bag)

    monkeypatch.setattr(BagFile, '_take', once)
    with pytest.raises(OSError, match='No locks available'):
        make_bag()


def test_a_complete_bag_without_its_name_is_renamed(
    make_bag: Callable[..., BagFile], tmp_path: Path, notes: Notes,
) -> None:
    bag = make_bag()
    write(bag, flight_messages('rocket', 1, 24))
    bag.close()
    (tmp_path / 'bag').rename(tmp_path / 'bag.partial')
    make_bag().close()
    assert 'its bag is complete' in notes.text
    assert len(read(tmp_path / 'bag')) == 1


def test_an_empty_bag_of_a_killed_recorder_is_removed(
    make_bag: Callable[..., BagFile], tmp_path: Path, notes: Notes,
) -> None:
    bag = make_bag()
    os.close(bag._lock)
    make_bag().close()
    assert 'killed before it received anything' in notes.text
    assert 'nothing was recorded: ' in notes.text
    assert not list(tmp_path.iterdir())


def test_two_recorders_cannot_write_one_bag(make_bag: Callable[..., BagFile]) -> None:
    bag = make_bag()
    with pytest.raises(OSError, match='another recorder writes this bag'):
        make_bag()
    write(bag, flight_messages('rocket', 1, 24))
    bag.close()


def test_a_full_disk_ends_a_whole_bag(
    make_bag: Callable[..., BagFile], tmp_path: Path, notes: Notes,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said = flight_messages('rocket', 1, STEPS)
    bag = make_bag()
    write(bag, said[:10])

    def full(folder: Path, needed: int = 0) -> None:
        raise OSError(28, 'only 3 MiB of disk left', str(folder))

    monkeypatch.setattr(bag_file, 'check_space', full)
    monkeypatch.setattr(bag_file, '_CHECK', 0)
    write(bag, said[10:])
    assert not bag.open
    assert 'the bag ends here: [Errno 28] only 3 MiB of disk left' in notes.text
    with AnyReader([tmp_path / 'bag']) as found:
        assert found.message_count == 10


def test_an_exceeded_quota_leaves_a_bag_to_repair(
    make_bag: Callable[..., BagFile], tmp_path: Path, notes: Notes,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse() -> None:
        raise OSError(errno.EDQUOT, 'Disk quota exceeded')  # as `write` does, without a name

    said = flight_messages('rocket', 1, STEPS)
    bag = make_bag()
    write(bag, said[:10])
    bag._writer.flush()
    monkeypatch.setattr(bag._writer, 'flush', refuse)
    monkeypatch.setattr(bag._writer, 'finish', refuse)
    monkeypatch.setattr(bag_file, 'FLUSH', 0.0)
    bag.tick()
    assert not bag.open
    assert not bag.complete
    file = tmp_path / 'bag.partial/bag_0.mcap'
    assert [text.split(': ', 1)[1] for level, text in notes if level == 'ERROR'] == 2 * [
        f"[Errno {errno.EDQUOT}] Disk quota exceeded: '{file}'"]
    again = make_bag()
    again.close()
    assert again.complete
    with AnyReader([tmp_path / 'bag']) as found:
        assert found.message_count == 10


def test_definitions_hold_all_messages_in_a_message() -> None:
    text = definitions.definition('nav_msgs/msg/Odometry')
    inner = re.findall(r'^MSG: (.*)$', text, re.MULTILINE)
    assert {'std_msgs/Header', 'builtin_interfaces/Time', 'geometry_msgs/Point'} <= set(inner)
    assert len(inner) == len(set(inner))
    with pytest.raises(ValueError, match="package 'nowhere_msgs' is not installed"):
        definitions.definition('nowhere_msgs/msg/Nothing')


def test_nested_messages_are_decoded() -> None:
    sent = Odometry(child_frame_id='rocket_0/base_link')
    sent.header.frame_id = 'wörld'
    sent.header.stamp.nanosec = 7
    sent.pose.covariance[35] = 2.5
    sent.twist.twist.angular.z = -1.25
    name = 'nav_msgs/msg/Odometry'
    found = Decoder(name, definitions.definition(name)).decode(bytes(serialize_message(sent)))
    assert found.header.frame_id == 'wörld'
    assert found.header.stamp.nanosec == 7
    assert found.child_frame_id == 'rocket_0/base_link'
    assert found.pose.covariance[35] == 2.5
    assert found.twist.twist.angular.z == -1.25
    empty = Decoder('diagnostic_msgs/msg/DiagnosticArray', definitions.definition(
        'diagnostic_msgs/msg/DiagnosticArray')).decode(bytes(serialize_message(DiagnosticArray())))
    assert empty.status == []


def test_every_end_of_a_message_is_noticed() -> None:
    name = 'rocket_msgs/msg/World'
    data = bytes(serialize_message(flight_messages('rocket', 1, 24)[0]))
    decoder = Decoder(name, definitions.definition(name))
    assert decoder.decode(data).world == 'rocket'
    for end in range(0, len(data) - 4, 7):
        with pytest.raises(ValueError, match=r'cut short|plain CDR|a sequence'):
            decoder.decode(data[:end])


def test_missed_steps_are_counted_from_the_bytes() -> None:
    counter = counter_of('rocket_msgs/msg/RocketState')
    assert counter is not None
    said = [bytes(serialize_message(message))
            for message in flight_messages('rocket', 2, 199, session=2**63 + 5)[1:]]
    found = [counter.note(data) for data in said[:2] + said[4:]]
    assert [gap for gap in found if gap] == [f'50 steps before step 100 of session {2**63 + 5}']
    assert counter.missed == 50
    single = counter_of('rocket_msgs/msg/Observation')
    assert single is not None
    for step in (5, 6, 6, 9):
        last = single.note(bytes(serialize_message(msg.Observation(session=1, step=step))))
    assert last == '2 steps before step 9 of session 1'
    assert counter_of('rocket_msgs/msg/World') is None
    assert counter.note(b'\x00\x01\x00\x00') == ''


@pytest.mark.parametrize(('kind', 'missing'), [(msg.Observation, 7), (msg.Action, 0)])
def test_first_steps_of_a_later_session_are_counted_where_only_the_simulator_publishes(
    kind: Any, missing: int,
) -> None:
    counter = counter_of(f'rocket_msgs/msg/{kind.__name__}')
    assert counter is not None
    for session, step in ((3, 40), (3, 41), (4, 0), (5, 7), (3, 42), (5, 8), (3, 43)):
        counter.note(bytes(serialize_message(kind(session=session, step=step))))
    assert counter.missed == missing
    before = counter.missed
    for session in range(10, 40):  # session 3 goes on while others come and go
        counter.note(bytes(serialize_message(kind(session=session, step=0))))
        counter.note(bytes(serialize_message(kind(session=3, step=34 + session))))
    assert counter.missed == before


def test_missing_episodes_are_counted_by_rocket_and_session() -> None:
    counter = counter_of('rocket_msgs/msg/Episodes')
    assert counter is not None
    said = [
        (1, 90, [0, 2], [5, 4]),  # nothing is known of earlier ones
        (1, 95, [1], [4]),
        (1, 180, [0, 1, 2], [6, 5, 8]),  # 5 to 7 of rocket 2
        (1, 180, [0, 1, 2], [6, 5, 8]),  # again
        (1, 270, [0, 1], [8, 6]),  # 7 of rocket 0
        (2, 90, [0, 1, 2], [0, 0, 0]),
        (2, 180, [0, 1, 2], [1, 1, 1]),
        (1, 360, [1], [8])]  # 7 of rocket 1; another simulator speaks on this topic by mistake
    texts = [
        counter.note(bytes(serialize_message(
            msg.Episodes(session=session, step=step, row=rows, episode=episodes))))
        for session, step, rows, episodes in said]
    assert [text for text in texts if text] == [
        '3 episodes before step 180 of session 1', '1 episodes before step 270 of session 1',
        '1 episodes before step 360 of session 1']
    assert (counter.missed, counter.unit) == (5, 'episodes')
    assert counter.note(bytes(serialize_message(msg.Episodes()))[:20]) == ''


def test_what_publishers_offer_is_written_with_the_first_message(
    make_bag: Callable[..., BagFile], tmp_path: Path,
) -> None:
    bag = make_bag()
    said = flight_messages('rocket', 1, 49)[1:]
    topic = topic_of(said[0])
    offered_quality = Quality(reliability='best_effort')
    bag.add_topic(replace(topic, offered=()))
    bag.add_topic(replace(topic, offered=(offered_quality,)))  # it has a publisher now
    bag.write(topic.name, serialized(said[0]), 10**9, 10**9)
    bag.add_topic(replace(topic, offered=(offered_quality, Quality())))  # and another one
    bag.add_topic(replace(topic, name='/silent'))
    for number, message in enumerate(said[1:], 2):
        bag.write(topic.name, serialized(message), number * 10**9, number * 10**9)
    bag.close()
    with AnyReader([tmp_path / 'bag']) as found:
        wanted = [one for one in found.connections if one.topic == topic.name]
        offers = [one.ext.offered_qos_profiles for one in wanted]
        assert [offer.reliability.name for one in offers for offer in one] == ['BEST_EFFORT']
        assert len(list(found.messages(wanted))) == len(said)
        assert {one.topic: one.msgcount for one in found.connections} == {
            topic.name: len(said), '/silent': 0}


def test_unfinished_flights_of_each_session_come_last(
        make_bag: Callable[..., BagFile], tmp_path: Path) -> None:
    bag = make_bag()
    write(bag, flight_messages('rocket', 1, 49, session=1))
    write(bag, flight_messages('rocket', 1, STEPS, session=2), at=3_000_000_000)
    bag.close()
    flights = read(tmp_path / 'bag')
    assert [bool(flight.outcome) for flight in flights] == [True, False, False]
    assert [len(flight) for flight in flights][1] == 50


def test_a_namespace_without_states_is_refused_by_the_conversion(
    make_bag: Callable[..., BagFile], tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    bag = make_bag()
    write(bag, flight_messages('rocket', 1, 49), '/sim_0')
    bag.close()
    arguments = [str(tmp_path / 'bag'), str(tmp_path / 'run.rrd')]
    assert to_rerun(arguments) == 2
    assert capsys.readouterr().err.splitlines()[-1] == (
        "to_rerun: namespace: got '', expected one of those with states in this bag: /sim_0")
    assert to_rerun([*arguments, '--namespace', '/sim_0']) == 0


def test_flights_that_a_conversion_leaves_out_are_counted(
    make_bag: Callable[..., BagFile], tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    bag = make_bag()
    write(bag, [msg.TrainingStatus(run='run', stage='finetune', iteration=1)], at=900_000_000)
    write(bag, flight_messages('rocket', 2, 900))
    bag.close()
    found = [flight for flight in read(tmp_path / 'bag') if flight.outcome]
    first = [flight for flight in found if not flight.episode]
    assert len(found) > len(first) == 2
    assert to_rerun([str(tmp_path / 'bag')]) == 0
    assert f'{len(found) - 2} flights are left out: ' in capsys.readouterr().err
    assert len(recordings.trajectories(tmp_path / 'bag.rrd')) == 2
    for options, count in (
            (['--every-nth-episode', '1'], len(found)), (['--crashes'], len(found)),
            (['--max-steps', '0'], 0)):
        assert to_rerun([str(tmp_path / 'bag'), *options]) == 0
        said = capsys.readouterr().err
        assert said.endswith(f'\n{count} flights\n')
        assert ('left out' in said) == (count < len(found))
    assert to_rerun([str(tmp_path / 'bag'), '--every-nth-episode', '0']) == 2
    assert 'every_nth_episode: got 0, expected 1 to' in capsys.readouterr().err


def test_a_bag_is_converted_in_its_own_folder(
    make_bag: Callable[..., BagFile], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    bag = make_bag()
    write(bag, flight_messages('rocket', 1, 49))
    bag.close()
    monkeypatch.chdir(tmp_path / 'bag')
    assert to_rerun(['.']) == 0
    assert (tmp_path / 'bag.rrd').is_file()
    assert to_rerun(['.', 'flights.txt']) == 2
    assert "output: got 'flights.txt', expected a name that ends" in capsys.readouterr().err


THEIRS = {
    'World': ('string world', 'World: got a rocket_msgs/msg/World without field'),
    'RocketState': ('uint64[] step', 'RocketState without field'),
    'TrainingStatus': ('string run', 'TrainingStatus without field'),
    'type': ('uint8 outcomes\nuint8 dt', 'World with fields of other types'),
    'itself': ('World[] inner', 'rocket_msgs/World: inner is of type rocket_msgs/World, which'),
    'each other': (f'Other one\n{"=" * 80}\nMSG: rocket_msgs/Other\nWorld two', ' contains '),
    'deep': ('M0 m\n' + ''.join(
        f'{"=" * 80}\nMSG: rocket_msgs/M{n}\nM{n + 1} m\n' for n in range(3_000))
        + f'{"=" * 80}\nMSG: rocket_msgs/M3000\nuint8 m', 'damaged')}
"""definitions of others, and the complaints about them"""


def one_of_theirs(path: Path, kind: str, text: str) -> Path:
    """Write a bag with one message of zeros, by a definition of others."""
    return write_records(path, [
        Schema(data=text.encode(), encoding='ros2msg', id=1, name=f'rocket_msgs/msg/{kind}'),
        Channel(id=1, topic=f'/{kind}', message_encoding='cdr', metadata={}, schema_id=1),
        Message(channel_id=1, log_time=1, data=b'\x00\x01\x00\x00' + bytes(64), publish_time=1,
                sequence=0)])


@pytest.mark.parametrize('what', THEIRS)
def test_messages_of_other_definitions_are_refused_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], what: str,
) -> None:
    text, complaint = THEIRS[what]
    kind = what if what in ('RocketState', 'TrainingStatus') else 'World'
    path = one_of_theirs(tmp_path / 'it.mcap', kind, text)
    assert to_rerun([str(path), str(tmp_path / 'it.rrd')]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert complaint in said and f'/{kind}: ' in said
    assert len(said) < 500
    if kind != 'TrainingStatus':
        with pytest.raises(ValueError, match=re.escape(complaint)):
            read(path)


@pytest.mark.parametrize(('kind', 'text'), [
    ('World', 'float64 dt\nstring[] outcomes'), ('TrainingStatus', f'string {LINES[0].value}')])
def test_messages_with_impossible_values_are_ignored_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, text: str,
) -> None:
    path = one_of_theirs(tmp_path / 'it.mcap', kind, text)
    assert to_rerun([str(path), str(tmp_path / 'it.rrd')]) == 0
    assert f'WARN: /{kind} ignored: ' in capsys.readouterr().err


def test_times_and_topics_of_messages(make_bag: Callable[..., BagFile], tmp_path: Path) -> None:
    bag = make_bag()
    said = flight_messages('rocket', 1, 49)
    write(bag, said)
    bag.close()
    found = list(messages(tmp_path / 'bag', topics=['/state']))
    assert [one.topic for one in found] == ['/state'] * (len(said) - 1)
    assert found[0].received - found[0].published == 1000
    np.testing.assert_array_equal(
        found[0].message.position.reshape(-1, 3),
        samples_of(said[1]).values[:, FIELDS['position']])
