# SPDX-License-Identifier: Apache-2.0
"""Recordings: flights are read back unchanged, and each file is small and has its own name."""
from __future__ import annotations

import errno
import itertools
import math
import os
import resource
import shutil
import time
from collections.abc import Iterator
from contextlib import ExitStack
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader
from support.recording.recordings import rows_of
from support.recording.recordings import view_classes

from rocket_sim_node import command_line
from rocket_sim_node import frames
from rocket_sim_node import palette
from rocket_sim_node.recording import reader
from rocket_sim_node.recording import trajectory_log
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing import timepoint
from rocket_sim_node.recording.drawing import training_plots
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.drawing.training_plots import Training
from rocket_sim_node.recording.recorder import EARLY
from rocket_sim_node.recording.recorder import Recorder
from rocket_sim_node.recording.scene import camera
from rocket_sim_node.recording.scene import rocket_model
from rocket_sim_node.recording.screenshot import ScreenshotSettings
from rocket_sim_node.recording.sinks import file_sink
from rocket_sim_node.recording.sinks import rerun_program
from rocket_sim_node.recording.sinks import rewrite
from rocket_sim_node.recording.sinks import rrd_file
from rocket_sim_node.recording.sinks.file_sink import FileSink
from rocket_sim_node.recording.sinks.file_sink import partial_path
from rocket_sim_node.recording.sinks.rrd_file import has_contents
from rocket_sim_node.recording.training_recorder import LONGEST_PERIOD
from rocket_sim_node.recording.training_recorder import MOST_GATHERED
from rocket_sim_node.recording.training_recorder import PERIOD
from rocket_sim_node.recording.training_recorder import TrainingRecorder
from rocket_sim_node.recording.trajectories.filter import RecordingFilter
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.trajectory import TrajectoryBuffer
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.telemetry.quantities import NO_OUTCOME
from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.samples import WIDTH
from rocket_sim_node.telemetry.samples import Samples
from rocket_sim_node.worlds import make

OUTCOMES = ('landed', 'too_fast', 'tipped', 'off_pad', 'tilt_limit', 'timeout', 'out_of_bounds')
STAGE = WorldInfo('rocket', 0.02, OUTCOMES)
Notes = list[tuple[str, str]]


def simulate(rockets: int, steps: int, seed: int = 0) -> Samples:
    """Fly: even rows brake in time and land, odd ones fall to the ground.

    Returns what a simulator publishes: all rows at each step, finished flights twice.
    """
    world = make('rocket', rockets, seed, level=1, spawn_angle=0.3)
    rows = np.arange(rockets)
    parts = [(0, world.telemetry(rows))]
    for step in range(1, steps + 1):
        now = parts[-1][1]
        height = np.maximum(now.position[:, 1] - 5.2, 0.05)
        wanted = now.mass * (9.81 + now.linear_velocity[:, 1] ** 2 / (2 * height)) / 470_880
        late = -now.linear_velocity[:, 1] > np.sqrt(2 * 5.0 * height) + 0.5
        throttle = np.where((late | (now.throttle > 0)) & (rows % 2 == 0), wanted, 0.0)
        action = np.zeros((rockets, 3), np.float32)
        action[:, 0] = np.clip(2 * throttle - 1, -1, 1)
        action[:, 1] = 0.002 * np.cos(0.1 * step)
        world.step(action)
        if len(world.finished.row):
            parts.append((step, world.finished))
        parts.append((step, world.telemetry(rows)))

    def join(name: str) -> np.ndarray:
        values = np.concatenate([getattr(part, name) for _, part in parts])
        if name == 'orientation':
            return frames.quaternion_to_ros(values)
        return frames.vector_to_ros(values) if values.ndim == 2 else values

    return Samples.build(
        np.concatenate([np.full(len(part.row), step) for step, part in parts]),
        join('row'), join('episode'), join('outcome'), **{name: join(name) for name in FIELDS})


@pytest.fixture(scope='module')
def flown() -> Samples:
    """Four rockets for 1 300 steps."""
    return simulate(4, 1300)


def flights_of(samples: Samples, row: int) -> list[np.ndarray]:
    """Return the values of the whole flights of one rocket, by other means than the recorder's."""
    mine = samples.take(np.flatnonzero(samples.row == row))
    return [
        mine.values[mine.episode == episode] for episode in np.unique(mine.episode)
        if np.any(mine.outcome[mine.episode == episode] != NO_OUTCOME)]


def feed(recorder: Recorder, samples: Samples, session: int = 1, piece: int = 100) -> None:
    """Hand samples to a recorder in messages of `piece`, as they would arrive."""
    recorder.world(STAGE)
    for start in range(0, len(samples.step), piece):
        recorder.states(session, samples.take(slice(start, start + piece)))


def record(
    path: Path, samples: Samples, choice: RecordingFilter | None = None,
) -> tuple[Recorder, Notes]:
    """Record samples to a file."""
    notes: Notes = []
    recorder = Recorder(
        choice or RecordingFilter(), [FileSink(path, lambda *note: notes.append(note))],
        lambda *note: notes.append(note))
    feed(recorder, samples)
    recorder.close()
    return recorder, notes


def test_recorded_flights_can_be_read_back(tmp_path: Path, flown: Samples) -> None:
    path = tmp_path / 'flights.rrd'
    recorder, _ = record(path, flown)
    rerun_program.verify(path)
    flights = reader.trajectories(path)
    assert recorder.flights == len(flights) == sum(len(flights_of(flown, k)) for k in range(4))
    assert {flight.outcome for flight in flights} == {'landed', 'too_fast'}
    for row in range(4):
        read_back = [flight for flight in flights if flight.row == row]
        for flight, values in zip(read_back, flights_of(flown, row), strict=True):
            def given(name: str, values: np.ndarray = values) -> np.ndarray:
                return values[:, FIELDS[name]].squeeze()

            close = {'rtol': 2e-6, 'atol': 1e-5}
            np.testing.assert_allclose(flight.time, given('time'), **close)
            np.testing.assert_array_equal(
                flight.position, given('position').astype(np.float32))
            np.testing.assert_array_equal(
                flight.orientation, given('orientation').astype(np.float32))
            np.testing.assert_allclose(flight.velocity, given('linear_velocity'), **close)
            x, y = given('orientation').T[:2]
            np.testing.assert_allclose(
                flight.tilt, np.degrees(np.arccos(1 - 2 * (x * x + y * y))), atol=0.05)
            np.testing.assert_allclose(flight.throttle, given('throttle'), **close)
            np.testing.assert_allclose(flight.fuel, given('fuel'), **close)
            np.testing.assert_allclose(flight.reward[1:], given('reward')[1:], **close)
            assert flight.summary['return'] == pytest.approx(given('reward')[1:].sum())
            assert flight.summary['speed'] == pytest.approx(
                np.linalg.norm(given('linear_velocity')[-1]))


def test_flights_follow_one_another_with_a_pause(tmp_path: Path, flown: Samples) -> None:
    path = tmp_path / 'flights.rrd'
    record(path, flown)
    flights = reader.trajectories(path)
    assert flights[0].start == pytest.approx(0.0)
    for before, after in itertools.pairwise(flights):
        pause = after.start - (before.start + float(before.time[-1]))
        assert pause == pytest.approx(timepoint.PAUSE + STAGE.dt, abs=1e-6)


@pytest.mark.slow
def test_size_and_layout(tmp_path: Path, flown: Samples) -> None:
    more = simulate(4, 5000, seed=1)
    sizes, steps = [], []
    for name, samples in (('few', flown), ('many', more)):
        recorder, _ = record(tmp_path / f'{name}.rrd', samples)
        sizes.append((tmp_path / f'{name}.rrd').stat().st_size)
        steps.append(recorder.steps)
    assert sizes[1] / steps[1] <= 150 * 1024 / 1000
    each = (sizes[1] - sizes[0]) / (steps[1] - steps[0])
    assert each <= 110 * 1024 / 1000
    assert sizes[0] - each * steps[0] <= 230 * 1024, 'layout, meshes and index'
    assert len(RrdReader(tmp_path / 'few.rrd').blueprints()) == 1


@pytest.mark.filterwarnings('error')
def test_large_files_are_copied_and_get_a_table_of_contents(
    tmp_path: Path, flown: Samples, monkeypatch: pytest.MonkeyPatch,
) -> None:
    small, large = tmp_path / 'small.rrd', tmp_path / 'large.rrd'
    record(small, flown)
    monkeypatch.setattr(file_sink, 'JOINED', 0)
    monkeypatch.setattr(rewrite, 'FLUSHED', 3)
    _, notes = record(large, flown)
    assert [level for level, _ in notes] == ['INFO']
    rerun_program.verify(large)
    assert [flight.summary for flight in reader.trajectories(large)] == [
        flight.summary for flight in reader.trajectories(small)]
    assert view_classes(large) == view_classes(small)
    assert sorted(p.name for p in tmp_path.iterdir()) == ['large.rrd', 'small.rrd']


def test_nothing_is_overwritten(tmp_path: Path, flown: Samples) -> None:
    part = flown.take(slice(0, 1500))
    for name in ('run.rrd', 'run-2.rrd', 'run-3.rrd'):
        _, notes = record(tmp_path / 'run.rrd', part)
        assert (tmp_path / name).is_file()
        assert name in notes[-1][1]
    assert sorted(p.name for p in tmp_path.iterdir()) == ['run-2.rrd', 'run-3.rrd', 'run.rrd']


def test_two_recorders_cannot_write_one_file(tmp_path: Path) -> None:
    first = FileSink(tmp_path / 'run.rrd', lambda *note: None)
    with pytest.raises(OSError, match=r'another recorder is writing this file.*run\.partial\.rrd'):
        FileSink(tmp_path / 'run.rrd', lambda *note: None)
    first.close()


def test_a_lock_that_cannot_be_had_is_named(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(lock: int, how: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(file_sink.fcntl, 'flock', refuse)
    with pytest.raises(OSError, match='cannot be locked: No locks available'):
        FileSink(tmp_path / 'run.rrd', lambda *note: None)


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / 'file').touch()
    with pytest.raises(OSError, match=str(tmp_path / 'file')):
        FileSink(tmp_path / 'file' / 'run.rrd', lambda *note: None)


@pytest.mark.parametrize('kind', ['FIFO', 'symbolic link'])
def test_a_fifo_or_symbolic_link_as_partial_file_is_refused(tmp_path: Path, kind: str) -> None:
    theirs, partial = tmp_path / 'theirs', tmp_path / 'run.partial.rrd'
    theirs.write_text('precious')
    if kind == 'FIFO':
        os.mkfifo(partial)
    else:
        partial.symlink_to(theirs)
    with pytest.raises(OSError, match=f'got a {kind}, expected a regular file.*{partial}'):
        FileSink(tmp_path / 'run.rrd', lambda *note: None)
    assert theirs.read_text() == 'precious'


def test_the_file_of_a_killed_recorder_is_repaired(tmp_path: Path, flown: Samples) -> None:
    path = tmp_path / 'run.rrd'
    sink = FileSink(path, lambda *note: None)
    recorder = Recorder(RecordingFilter(), [sink], lambda *note: None)
    feed(recorder, flown)
    assert sink._stream is not None
    sink._stream.flush()
    cut_off = partial_path(path).read_bytes()[:-1000]
    recorder.close()
    path.unlink()
    partial_path(path).write_bytes(cut_off)
    notes: Notes = []
    FileSink(path, lambda *note: notes.append(note)).close()
    assert any('repaired' in text and level == 'WARN' for level, text in notes)
    rerun_program.verify(path)
    assert 0 < len(reader.trajectories(path)) <= recorder.flights
    assert [p.name for p in tmp_path.iterdir()] == ['run.rrd']


def test_an_empty_file_of_a_killed_recorder_is_removed(
    tmp_path: Path,
) -> None:
    path = tmp_path / 'run.rrd'
    sink = FileSink(path, lambda *note: None)
    assert sink._stream is not None
    sink._stream.flush()
    layout = partial_path(path).read_bytes()
    assert layout
    sink.close()
    partial_path(path).write_bytes(layout)
    notes: Notes = []
    FileSink(path, lambda *note: notes.append(note)).close()
    assert notes[0] == ('INFO', 'a recorder was killed before it received anything')
    assert not list(tmp_path.iterdir())


def test_a_terminated_repair_is_done_again_later(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As when a job is terminated with all its processes."""
    path, whole = tmp_path / 'run.rrd', tmp_path / 'whole.rrd'
    record(whole, simulate(1, 150))
    cut = whole.read_bytes()[:-2000]
    partial_path(path).write_bytes(cut)
    ended = tmp_path / 'rerun'
    ended.write_text('#!/bin/sh\nkill -TERM $$\n')
    ended.chmod(0o755)
    with monkeypatch.context() as patched:
        patched.setattr(rerun_program, 'binary', lambda: ended)
        with pytest.raises(OSError, match=r'not repaired yet, .* ended by signal 15'):
            FileSink(path, lambda *note: None)
    assert partial_path(path).read_bytes() == cut
    notes: Notes = []
    FileSink(path, lambda *note: notes.append(note)).close()
    assert 'its recording is repaired' in notes[0][1]
    assert path.exists() and not partial_path(path).exists()


def test_a_file_that_cannot_be_repaired_is_kept(tmp_path: Path) -> None:
    partial_path(tmp_path / 'run.rrd').write_bytes(b'no recording' * 100)
    notes: Notes = []
    FileSink(tmp_path / 'run.rrd', lambda *note: notes.append(note)).close()
    assert 'cannot be repaired' in notes[0][1]
    assert (tmp_path / 'run.damaged').read_bytes() == b'no recording' * 100


def leave_free(patch: pytest.MonkeyPatch, size: int) -> None:
    """Make every disk report that so many bytes are left."""
    usage = shutil.disk_usage('/')
    patch.setattr(shutil, 'disk_usage', lambda place: usage._replace(free=size))


def test_a_full_disk_ends_the_recording_whole(
    tmp_path: Path, flown: Samples, monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = tmp_path / 'run.rrd'
    notes: Notes = []
    sink = FileSink(path, lambda *note: notes.append(note))
    recorder = Recorder(RecordingFilter(), [sink], lambda *note: None)
    half = len(flown.step) // 2
    feed(recorder, flown.take(slice(0, half)))
    leave_free(monkeypatch, 20 * 2**20)
    feed(recorder, flown.take(slice(half, None)))
    assert [level for level, _ in notes] == ['ERROR', 'INFO']
    assert 'only 20 MiB of disk left, 32 MiB needed' in notes[0][1]
    rerun_program.verify(path)
    recorder.close()
    assert 0 < recorder.flights == len(reader.trajectories(path))


def test_without_room_for_a_copy_there_is_no_table_of_contents(
    tmp_path: Path, flown: Samples, monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = tmp_path / 'run.rrd'
    notes: Notes = []
    sink = FileSink(path, lambda *note: notes.append(note))
    feed(Recorder(RecordingFilter(), [sink], lambda *note: None), flown)
    leave_free(monkeypatch, 16 * 2**20)
    sink.close()
    assert [level for level, _ in notes] == ['WARN', 'INFO']
    assert 'has no table of contents' in notes[0][1]
    assert not has_contents(path)
    assert reader.trajectories(path)
    assert [p.name for p in tmp_path.iterdir()] == ['run.rrd']


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Let no write of this process go beyond so many bytes of a file, as on a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_quota_that_is_used_up_is_named_at_once(tmp_path: Path) -> None:
    with largest_file(4096), pytest.raises(
            OSError, match=r'could not be written: File too large.*run\.partial\.rrd'):
        FileSink(tmp_path / 'run.rrd', lambda *note: None)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize('part', [0.3, 0.6, 0.9])
def test_a_recording_cut_short_is_repaired_by_the_next_recorder(
    tmp_path: Path, flown: Samples, part: float,
) -> None:
    whole, path = tmp_path / 'whole.rrd', tmp_path / 'run.rrd'
    record(whole, flown)
    notes: Notes = []
    with largest_file(int(part * whole.stat().st_size)):
        sink = FileSink(path, lambda *note: notes.append(note))
        recorder = Recorder(RecordingFilter(), [sink], lambda *note: None)
        feed(recorder, flown)
        begun = time.monotonic()
        recorder.close()
        assert time.monotonic() - begun < 20.0
    assert [level for level, _ in notes] == ['ERROR']
    assert 'remains at' in notes[0][1]
    assert not path.exists()
    FileSink(path, lambda *note: notes.append(note)).close()
    assert 'its recording is repaired' in notes[1][1]
    rerun_program.verify(path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ['run.rrd', 'whole.rrd']


@pytest.mark.slow
@pytest.mark.parametrize('joined', [0, 2**30])
@pytest.mark.parametrize('short', [3_000, 20_000, 200_000])
def test_a_table_of_contents_that_cannot_be_written_costs_nothing_else(
    tmp_path: Path, flown: Samples, monkeypatch: pytest.MonkeyPatch, joined: int, short: int,
) -> None:
    """The disk is full within the copy or, by the end, within its table of contents."""
    monkeypatch.setattr(file_sink, 'JOINED', joined)
    whole, path = tmp_path / 'whole.rrd', tmp_path / 'run.rrd'
    record(whole, flown)
    notes: Notes = []
    sink = FileSink(path, lambda *note: notes.append(note))
    feed(Recorder(RecordingFilter(), [sink], lambda *note: None), flown)
    end = file_sink.end
    with ExitStack() as stack:
        def end_and_fill_the_disk(stream: rr.RecordingStream) -> None:
            end(stream)
            stack.enter_context(largest_file(whole.stat().st_size - short))

        monkeypatch.setattr(file_sink, 'end', end_and_fill_the_disk)
        monkeypatch.setattr(rrd_file, 'PATIENCE', 3.0)
        sink.close()
    assert [level for level, _ in notes] == ['WARN', 'INFO']
    assert [flight.summary for flight in reader.trajectories(path)] == [
        flight.summary for flight in reader.trajectories(whole)]
    assert sorted(p.name for p in tmp_path.iterdir()) == ['run.rrd', 'whole.rrd']


def test_a_failed_writer_is_noticed_while_recording(
    tmp_path: Path, flown: Samples, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The disk shows room again, or a quota is the limit."""
    monkeypatch.setattr(file_sink, 'LOOK', 0.0)
    monkeypatch.setattr(rrd_file, 'PATIENCE', 1.0)
    notes: Notes = []
    sink = FileSink(tmp_path / 'run.rrd', lambda *note: notes.append(note))
    recorder = Recorder(RecordingFilter(), [sink], lambda *note: None)
    with largest_file(200_000):
        feed(recorder, flown)
    assert [level for level, _ in notes] == ['ERROR']
    assert 'remains at' in notes[0][1]
    before = recorder.flights
    feed(recorder, flown, session=2)
    assert recorder.flights == before
    recorder.close()
    assert len(notes) == 1


def test_one_stalled_flush_is_tolerated_and_two_end_the_recording(
    tmp_path: Path, flown: Samples, monkeypatch: pytest.MonkeyPatch,
) -> None:
    stands = [True, False, True, True]

    def flush(stream: object) -> None:
        if stands and stands.pop(0):
            raise RuntimeError('time is over')

    monkeypatch.setattr(file_sink, 'LOOK', 0.0)
    monkeypatch.setattr(file_sink, 'PATIENCE', 0.0)
    monkeypatch.setattr(file_sink, 'flush', flush)
    notes: Notes = []
    sink = FileSink(tmp_path / 'run.rrd', lambda *note: notes.append(note))
    recorder = Recorder(RecordingFilter(), [sink], lambda *note: None)
    session = 1
    while stands:
        feed(recorder, flown, session=session)
        session += 1
    assert [level for level, _ in notes] == ['WARN', 'WARN', 'ERROR', 'INFO']
    assert 'nothing has been written' in notes[0][1]
    assert 'the recording ends here: time is over' in notes[2][1]
    before = recorder.flights
    feed(recorder, flown, session=session)
    recorder.close()
    assert 0 < recorder.flights == before
    # The last one is in the file, but that is not guaranteed.
    assert before <= len(reader.trajectories(tmp_path / 'run.rrd')) <= before + 1


def test_a_recorder_without_disk_space_releases_the_file(
    tmp_path: Path, flown: Samples, monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = tmp_path / 'run.rrd'
    with monkeypatch.context() as patch:
        leave_free(patch, 2**20)
        with pytest.raises(OSError, match='only 1 MiB of disk left, 32 MiB needed'):
            FileSink(path, lambda *note: None)
        assert not list(tmp_path.iterdir())
    record_to_partial(path, flown)
    with monkeypatch.context() as patch:
        leave_free(patch, 32 * 2**20)
        before = partial_path(path).read_bytes()
        with pytest.raises(OSError, match='only 32 MiB of disk left, 33 MiB needed'):
            FileSink(path, lambda *note: None)
        assert partial_path(path).read_bytes() == before
    record(path, flown)
    assert sorted(p.name for p in tmp_path.iterdir()) == ['run-2.rrd', 'run.rrd']


def record_to_partial(path: Path, samples: Samples) -> None:
    """Leave what a recorder that was killed leaves."""
    other = path.with_name('other.rrd')
    record(other, samples)
    other.replace(partial_path(path))


def test_a_file_published_by_a_killed_recorder_is_not_changed(
    tmp_path: Path, flown: Samples,
) -> None:
    """Its file has both names for a moment."""
    path = tmp_path / 'run.rrd'
    record_to_partial(path, flown)
    path.hardlink_to(partial_path(path))
    before = path.read_bytes()
    _, notes = record(path, flown)
    assert [level for level, _ in notes] == ['INFO']
    assert path.read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ['run-2.rrd', 'run.rrd']


def test_a_file_that_cannot_be_renamed_is_kept(
    tmp_path: Path, flown: Samples, monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(source: Path, path: Path) -> Path:
        raise PermissionError(1, 'not now', str(path))

    monkeypatch.setattr(file_sink, 'publish', refuse)
    _, notes = record(tmp_path / 'run.rrd', flown)
    assert [level for level, _ in notes] == ['ERROR']
    assert 'is complete, but remains at' in notes[0][1]
    rerun_program.verify(partial_path(tmp_path / 'run.rrd'))
    assert len(list(tmp_path.iterdir())) == 1


def test_a_removed_partial_file_is_reported(tmp_path: Path, flown: Samples) -> None:
    path = tmp_path / 'run.rrd'
    notes: Notes = []
    sink = FileSink(path, lambda *note: notes.append(note))
    recorder = Recorder(RecordingFilter(), [sink], lambda *note: None)
    feed(recorder, flown)
    partial_path(path).unlink()
    other = FileSink(path, lambda *note: None)
    feed(Recorder(RecordingFilter(), [other], lambda *note: None), flown)
    recorder.close()
    assert [level for level, _ in notes] == ['ERROR']
    assert 'is lost' in notes[0][1]
    assert [p.name for p in tmp_path.iterdir()] == ['run.partial.rrd']
    other.close()
    assert reader.trajectories(path)


def test_a_large_file_of_a_killed_recorder_is_not_joined(
    tmp_path: Path, flown: Samples, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(file_sink, 'JOINED', 0)
    monkeypatch.setattr(file_sink, 'rewrite', None)
    whole, path = tmp_path / 'whole.rrd', tmp_path / 'run.rrd'
    record(whole, flown)
    partial_path(path).write_bytes(whole.read_bytes()[:-1000])
    path.with_name('run.partial.whole.rrd').write_bytes(b'left behind')
    notes: Notes = []
    FileSink(path, lambda *note: notes.append(note)).close()
    assert 'its recording is repaired' in notes[0][1]
    rerun_program.verify(path)
    assert reader.trajectories(path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ['run.rrd', 'whole.rrd']


def test_a_recording_has_no_table_of_contents_while_it_is_written(
    tmp_path: Path, flown: Samples,
) -> None:
    """Rerun would keep it in memory."""
    sink = FileSink(tmp_path / 'run.rrd', lambda *note: None)
    feed(Recorder(RecordingFilter(), [sink], lambda *note: None), flown)
    assert sink._stream is not None
    sink._stream.flush()
    sink._stream.disconnect()
    assert not has_contents(partial_path(tmp_path / 'run.rrd'))
    assert reader.trajectories(partial_path(tmp_path / 'run.rrd'))


def buffer_feed(buffer: TrajectoryBuffer, samples: Samples, *spans: tuple[int, int]) -> list[bool]:
    return [buffer.extend(samples.take(slice(*span))) for span in spans]


def test_a_flight_with_a_gap_is_dropped(flown: Samples) -> None:
    mine = flown.take(np.flatnonzero(flown.row == 0))
    buffer = TrajectoryBuffer(capacity=8)
    assert buffer_feed(buffer, mine, (0, 10), (10, 100)) == [True, True]
    assert len(buffer) == 100
    assert buffer_feed(buffer, mine, (101, 110), (110, 120)) == [False, False]
    assert len(buffer) == 0
    assert buffer_feed(buffer, mine, (5, 20)) == [False]
    twice = mine.take(np.array([0, 1, 1, 2]))
    assert not buffer.extend(twice)


def test_a_new_session_drops_unfinished_flights(tmp_path: Path, flown: Samples) -> None:
    recorder = Recorder(RecordingFilter(rows=(0,)), [], lambda *note: None)
    first_end = int(np.flatnonzero((flown.row == 0) & (flown.outcome != NO_OUTCOME))[0])
    feed(recorder, flown.take(slice(0, first_end - 20)), session=1)
    rest = flown.take(slice(first_end - 20, first_end + 1))
    recorder.states(2, rest)
    recorder.states(1, rest)
    assert recorder.flights == 0
    feed(recorder, flown, session=1)
    assert recorder.flights > 0


def test_samples_may_arrive_before_their_world(flown: Samples) -> None:
    recorder = Recorder(RecordingFilter(), [], lambda *note: None)
    recorder.states(1, flown)
    assert recorder.flights == 0
    recorder.world(STAGE)
    assert recorder.flights == sum(len(flights_of(flown, row)) for row in range(4))


def test_gaps_in_samples_that_arrived_before_their_world_are_reported(flown: Samples) -> None:
    notes: list[tuple[str, str]] = []
    recorder = Recorder(RecordingFilter(), [], lambda *note: notes.append(note))
    recorder.states(1, flown.take(flown.step <= 10))
    recorder.states(1, flown.take(flown.step > 15))
    assert not notes
    recorder.world(STAGE)
    assert notes == [('WARN', 'state: 5 steps before step 16 were not received: flights in '
                             'progress are not recorded')]
    assert recorder.missed == 5


def test_samples_dropped_without_their_world_are_reported(flown: Samples) -> None:
    notes: list[tuple[str, str]] = []
    recorder = Recorder(RecordingFilter(), [], lambda *note: notes.append(note))
    for _ in range(EARLY + 1):
        recorder.states(1, flown.take(flown.step == 0))
    assert notes == [('WARN', f'state: more than {EARLY} messages arrived before the description '
                             'on topic world: the oldest are ignored')]


@pytest.mark.parametrize(('choice', 'learning', 'expected'), [
    (RecordingFilter(rows=(0, 1), every_nth_episode=2), True, [(0, 0), (1, 0), (1, 2)]),
    (RecordingFilter(rows=(0, 1), every_nth_episode=2, crashes=True), True,
     [(0, 0), (1, 0), (1, 1), (1, 2), (1, 3)]),
    (RecordingFilter(rows=(1,), every_nth_episode=2), False, [(1, 0), (1, 1), (1, 2), (1, 3)]),
    (RecordingFilter(rows=(7,)), False, []),
])
def test_the_filter_selects_flights_by_row_episode_and_outcome(
    tmp_path: Path, flown: Samples, choice: RecordingFilter, learning: bool,
    expected: list[tuple[int, int]],
) -> None:
    path = tmp_path / 'run.rrd'
    recorder = Recorder(choice, [FileSink(path, lambda *note: None)], lambda *note: None)
    recorder.world(STAGE)
    if learning:
        recorder.training(Training('finetune', 1, {}))
    feed(recorder, flown)
    recorder.close()
    assert path.exists() == bool(expected), 'nothing recorded leaves no file'
    got = {(flight.row, flight.episode)
           for flight in (reader.trajectories(path) if expected else ())}
    assert {pair for pair in got if pair in expected} == got
    assert got == {pair for pair in expected if pair in got}
    assert len(got) == len([pair for pair in expected if has_ended(flown, pair)])


def has_ended(samples: Samples, pair: tuple[int, int]) -> bool:
    mine = (samples.row == pair[0]) & (samples.episode == pair[1])
    return bool(np.any(samples.outcome[mine] != NO_OUTCOME))


def test_the_room_is_shared_between_training_and_evaluation(flown: Samples) -> None:
    notes: Notes = []
    recorder = Recorder(RecordingFilter(max_steps=2000), [], lambda *note: notes.append(note))
    recorder.training(Training('finetune', 1, {}))
    feed(recorder, flown)
    assert 0 < recorder.steps <= 1000
    assert len(notes) == 1
    assert 'until training ends' in notes[0][1]
    recorder.training(Training('evaluate', 1, {}))
    feed(recorder, flown, session=2)
    assert 1000 < recorder.steps <= 2000
    assert len(notes) == 2


def test_training_reports_are_recorded_by_iteration(tmp_path: Path, flown: Samples) -> None:
    path = tmp_path / 'run.rrd'
    recorder = Recorder(
        RecordingFilter(), [FileSink(path, lambda *note: None)], lambda *note: None)
    recorder.training(Training('clone', 1, {'clone_loss': 0.5, 'mean_return': float('nan')}))
    feed(recorder, flown)
    for k in range(1, 4):
        recorder.training(Training(
            'finetune', k, {'mean_return': 10.0 * k, 'landing_rate': 0.25 * k, 'level': 3}))
    recorder.close()
    rerun_program.verify(path)
    columns: dict[str, list[tuple[int, list[float]]]] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if 'Scalars:scalars' in batch.schema.names:
            columns[chunk.entity_path] = list(zip(
                batch.column('iteration').to_pylist(),
                batch.column('Scalars:scalars').to_pylist(), strict=True))
    assert columns['/training/return'] == [(2, [10.0]), (3, [20.0]), (4, [30.0])]
    assert columns['/training/cloning'][0][0] == 1
    assert columns['/training/cloning'][0][1][0] == 0.5
    rate = [row[1][2] for row in columns['/training/landing_rate']]
    assert rate == [25.0, 50.0, 75.0]
    assert '/training/loss' not in columns


@pytest.mark.parametrize('trains', [True, False])
def test_flights_lie_on_the_training_timeline_from_its_first_report_on(
        tmp_path: Path, flown: Samples, trains: bool) -> None:
    path = tmp_path / 'run.rrd'
    recorder = Recorder(
        RecordingFilter(), [FileSink(path, lambda *note: None)], lambda *note: None)
    if trains:
        recorder.training(Training('demonstrate', 0, {}))
    feed(recorder, flown)
    recorder.close()
    marks = rows_of(path, entities.LANDINGS, 'Points3D:positions', timeline='iteration')
    assert [iteration for iteration, _ in marks] == [0] * (recorder.flights if trains else 0)


def test_iterations_go_on_through_the_stages() -> None:
    counter = training_plots.IterationCounter()
    stages = [('clone', 1), ('clone', 2), ('finetune', 1), ('finetune', 5), ('evaluate', 100)]
    # An evaluation counts episodes.
    numbers = [counter.add(Training(stage, count, {})) for stage, count in stages]
    assert numbers == [1, 2, 3, 7, 7]
    again = [counter.add(Training('finetune', count, {}, run='two')) for count in (1, 2)]
    assert again == [8, 9]


def straight(height: np.ndarray, throttle: np.ndarray) -> Trajectory:
    """Return a flight straight down, upright."""
    values = np.zeros((len(height), WIDTH))
    values[:, FIELDS['position'].start + 2] = height
    values[:, FIELDS['orientation'].stop - 1] = 1.0
    values[:, FIELDS['throttle'].start] = throttle
    return Trajectory(0, 0, 0, 'landed', values)


def test_phases_ignore_chatter() -> None:
    throttle = np.concatenate((np.zeros(30), [0.5, 0.0, 0.5], np.zeros(20), np.full(40, 0.8)))
    flight = straight(np.linspace(100, 5.2, len(throttle)), throttle)
    assert trajectory_log.phases(flight) == [(0, 'fall'), (53, 'burn'), (92, 'landed')]


def test_the_view_holds_rocket_and_pad() -> None:
    height = np.linspace(200, 5.2, 400)
    view = camera.shots(straight(height, np.zeros(400)), STAGE)
    assert np.all(view[:, 2] + view[:, 3] / 2 >= height + rocket_model.NOSE)
    assert np.all(view[:, 2] - view[:, 3] / 2 <= 0.0)
    assert view[-1, 3] < 0.4 * view[0, 3]


def test_the_vehicle_stands_on_its_feet() -> None:
    mesh = rocket_model.rocket()
    assert mesh.position[:, 2].min() == pytest.approx(-STAGE.touchdown_height)
    assert mesh.position[:, 2].max() == pytest.approx(rocket_model.NOSE)
    assert mesh.triangle.max() < len(mesh.position)
    np.testing.assert_allclose(np.linalg.norm(mesh.normal, axis=1), 1.0, atol=1e-5)
    corner = mesh.position[mesh.triangle].astype(np.float64)
    facing = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    given = mesh.normal[mesh.triangle].mean(axis=1)
    assert np.all(np.einsum('ij,ij->i', facing, given) >= -1e-6)


def test_body_vectors() -> None:
    half = np.sqrt(0.5)
    about_x = np.array([[half, 0.0, 0.0, half]])
    np.testing.assert_allclose(
        frames.to_body(about_x, np.array([[0.0, 0.0, 1.0]])), [[0.0, 1.0, 0.0]], atol=1e-12)


def test_colours_differ() -> None:
    for outcomes in (OUTCOMES, ('landed', 'crashed', 'asleep', 'out')):
        colours = palette.outcome_colours(outcomes)
        assert len(set(colours.values())) == len(outcomes)
        assert colours['landed'] == palette.GREEN


def test_wrong_samples_are_named() -> None:
    whole = np.zeros(2, np.int64)
    quantities = {
        name: np.zeros(2 * (place.stop - place.start)) for name, place in FIELDS.items()}
    quantities['position'] = np.zeros(5)
    with pytest.raises(ValueError, match=r'position: 5 values, expected 6 \(2 samples x 3\)'):
        Samples.build(whole, whole, whole, whole, **quantities)


@pytest.mark.parametrize(('arguments', 'complaint'), [
    (['at'], 'expected NAME:=VALUE'), (['when:=burn'], "unknown setting 'when'"),
    (['width:=10'], 'width: got 10'), (['tab:=x'], "tab: got 'x'"),
    (['tab:=plots', 'tab:=plots'], 'tab: given twice'),
])
def test_wrong_arguments_of_screenshot_are_named(arguments: list[str], complaint: str) -> None:
    with pytest.raises((ValueError, TypeError), match=complaint):
        command_line.parse(ScreenshotSettings, arguments)


def test_a_file_that_is_not_a_recording_is_named(tmp_path: Path) -> None:
    with pytest.raises(OSError, match='no such recording'):
        reader.trajectories(tmp_path / 'none.rrd')
    (tmp_path / 'junk.rrd').write_bytes(b'junk' * 100)
    with pytest.raises(OSError, match='not a readable recording'):
        reader.trajectories(tmp_path / 'junk.rrd')
    with rr.RecordingStream('another') as stream:
        stream.save(tmp_path / 'theirs.rrd')
        stream.log('/world/rocket', rr.TextLog('no rocket'))
        stream.disconnect()
    with pytest.raises(OSError, match='not a recording of flights'):
        reader.trajectories(tmp_path / 'theirs.rrd')


def test_a_long_training_is_logged_in_ever_larger_parts() -> None:
    """Each part stays in memory, in the index: a day of training has few hundreds of them."""
    now, puts = 0.0, 0

    def put(logged: object) -> None:
        nonlocal puts
        puts += 1

    training = TrainingRecorder(put, lambda: now)
    waited, gathered = 0.0, 0.0
    for second in range(24 * 3600):
        now = float(second)
        before = puts
        text = 'saved' if second % 5 == 0 else ''
        training.add(Training('finetune', second + 1, {}, text), 0, 0.02)
        if puts > before:
            waited, gathered = max(waited, now - gathered), now
        if second == 600:
            assert puts > 2 * 600 / PERIOD * 0.9, 'at first they are seen soon'
            assert waited <= PERIOD + 1.0
    assert waited <= LONGEST_PERIOD + 1.0
    assert puts < 2 * 24 * 3600 / LONGEST_PERIOD * 1.2
    training.flush(0.02)
    after = puts
    training.flush(0.02)
    assert puts == after


def test_the_number_of_waiting_training_reports_is_limited() -> None:
    puts: list[object] = []
    training = TrainingRecorder(puts.append, lambda: 0.0)
    training.add(Training('finetune', 1, {}), 0, 0.02)
    began = len(puts)
    for number in range(2, MOST_GATHERED + 2):
        training.add(Training('finetune', number, {}), 0, 0.02)
    assert len(puts) == began + 1
    training.flush(0.02)
    assert len(puts) == began + 1


def test_gathered_reports_hold_the_reported_values() -> None:
    gathered = training_plots.GatheredReports()
    places, values = gathered.take()
    assert (len(gathered), places, values.shape) == (0, [], (0, len(training_plots.LINES)))
    reports = [
        (Timepoint(2**60 + 1, 7), {'mean_return': 1.5, 'landing_rate': 0.25, 'log_std': math.inf}),
        (Timepoint(2**60 + 2), {})]
    for report in reports:
        gathered.add(*report)
    with pytest.raises((TypeError, OverflowError)):
        gathered.add(Timepoint(3, 8), {'log_std': 10**400})
    assert len(gathered) == 2
    places, values = gathered.take()
    assert places == [Timepoint(2**60 + 1, 7), Timepoint(2**60 + 2, 0)]
    row = dict(zip((line.value for line in training_plots.LINES), values[0], strict=True))
    assert (row['mean_return'], row['landing_rate'], row['log_std']) == (1.5, 25.0, math.inf)
    assert np.isnan(values).sum() == 2 * len(training_plots.LINES) - 3
    assert len(gathered) == 0
