# SPDX-License-Identifier: Apache-2.0
"""Live viewers: flights while they happen, and viewers that connect late or reconnect."""
from __future__ import annotations

import threading
import time
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from typing import cast

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader
from support.processes import wait_until
from support.recording.recordings import fly

from rocket_sim_node.recording import reader
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing import timepoint
from rocket_sim_node.recording.drawing.training_plots import Training
from rocket_sim_node.recording.recorder import Recorder
from rocket_sim_node.recording.sinks import rerun_program
from rocket_sim_node.recording.sinks.base import Look
from rocket_sim_node.recording.sinks.base import Put
from rocket_sim_node.recording.sinks.file_sink import FileSink
from rocket_sim_node.recording.sinks.increments import FOR_EVER
from rocket_sim_node.recording.sinks.increments import Increments
from rocket_sim_node.recording.sinks.live_sink import LiveSink
from rocket_sim_node.recording.trajectories import follower
from rocket_sim_node.recording.trajectories.filter import RecordingFilter
from rocket_sim_node.recording.trajectories.trajectory import Settling
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.telemetry.capture import Telemetry
from rocket_sim_node.telemetry.quantities import NO_OUTCOME
from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.samples import Samples

Notes = list[tuple[str, str]]
Rows = dict[str, dict[int, dict[str, Any]]]
ROCKETS = 2


def brake(state: Telemetry, observation: np.ndarray) -> np.ndarray:
    """Row 0 lands as well as it can, row 1 falls."""
    height = np.maximum(state.position[:, 1] - 5.2, 0.05)
    speed = -state.linear_velocity[:, 1]
    wanted = state.mass * (9.81 + speed ** 2 / (2 * height)) / 470_880
    on = (speed > np.sqrt(10.0 * height) + 0.5) | (state.throttle > 0)
    action = np.zeros((ROCKETS, 3), np.float32)
    action[:, 0] = np.where(on & (np.arange(ROCKETS) == 0), np.clip(2 * wanted - 1, -1, 1), -1)
    return action


def fire(state: Telemetry, observation: np.ndarray) -> np.ndarray:
    """Use all engines of the lander in turn."""
    return np.where(np.arange(ROCKETS) == 0, (state.time / state.time.max(initial=0.02) * 3), 1) \
        .astype(np.int32) % 4


PILOTS = {'rocket': brake, 'rocket_planar': brake, 'lunar_lander': fire}
DISTURBED = {'thrust_factor': 0.98, 'engine_lag': 0.05, 'gust_deviation': 0.3}
SETTINGS: dict[str, dict[str, float]] = {
    'rocket': {'level': 1, 'spawn_angle': 0.3}, 'rocket_planar': {'level': 1}, 'lunar_lander': {}}


@pytest.fixture(scope='module', params=[*PILOTS, 'rocket, disturbed'])
def flown(request: pytest.FixtureRequest) -> tuple[WorldInfo, Samples]:
    """Return a world and what two vehicles did in it for 700 steps."""
    name, _, disturbed = request.param.partition(', ')
    world, samples = fly(
        name, ROCKETS, 700, PILOTS[name], **SETTINGS[name], **(DISTURBED if disturbed else {}))
    spec = world.spec
    return WorldInfo.build(
        spec.name, spec.dt, spec.outcomes, spec.settings, spec.condition_names), samples


class Tape:
    """A live sink whose viewer is a file."""

    live = True

    def __init__(self, path: Path) -> None:
        self.stream = rr.RecordingStream('tape')
        self.stream.set_log_time_enabled(False)
        self.stream.save(path)
        self.unsent = Increments(self.stream)
        self.looks: list[Look] = []
        self.parts = 0
        self.flights = 0

    def begin(self, head: Put, look: Look) -> None:
        head(self.stream)
        self.looks.append(look)

    def write(self, put: Put) -> None:
        put(self.stream)

    def write_trajectory(self, put: Put) -> bool:
        self.under_way(put, FOR_EVER)
        self.flights += 1
        return True

    def under_way(self, put: Put, until: int) -> None:
        self.unsent.until = until
        put(cast('rr.RecordingStream', self.unsent))
        self.parts += 1

    def close(self) -> None:
        self.stream.flush()
        self.stream.disconnect()


class Blind(Tape):
    """A live sink that only counts."""

    def under_way(self, put: Put, until: int) -> None:
        self.parts += 1


class Clock:
    """Time that goes on by so many s with each look at it."""

    def __init__(self, pace: float) -> None:
        self.now, self.pace = 0.0, pace

    def __call__(self) -> float:
        self.now += self.pace
        return self.now


def feed(
    recorder: Recorder, flown: tuple[WorldInfo, Samples], session: int = 1, piece: int = 7,
) -> None:
    stage, samples = flown
    recorder.world(stage)
    for start in range(0, len(samples.step), piece):
        recorder.states(session, samples.take(slice(start, start + piece)))


def rows(path: Path) -> Rows:
    """Return all that stands on the timeline of steps, by entity, step and component."""
    table: Rows = {}
    for chunk in RrdReader(path).stream():
        if chunk.is_static or 'step' not in chunk.timeline_names:
            continue
        batch = chunk.to_record_batch()
        for row in batch.to_pylist():
            kept = {
                name: value for name, value in row.items()
                if value is not None and name not in ('step', 'rerun.controls.RowId')}
            table.setdefault(chunk.entity_path, {}).setdefault(row['step'], {}).update(kept)
    return table


@pytest.mark.slow
def test_the_live_stream_matches_the_recording(
    tmp_path: Path, flown: tuple[WorldInfo, Samples],
) -> None:
    tape = Tape(tmp_path / 'live.rrd')
    file = FileSink(tmp_path / 'file.rrd', lambda *note: None)
    # A glance at each message: of two vehicles one is followed, the other waits for its end.
    recorder = Recorder(
        RecordingFilter(), [tape, file], lambda *note: None, Clock(follower.PERIOD))
    feed(recorder, flown)
    recorder.close()
    assert tape.flights == recorder.flights > 1
    assert tape.parts > 3 * tape.flights
    live, whole = rows(tmp_path / 'live.rrd'), rows(tmp_path / 'file.rrd')
    summaries = [f.summary for f in reader.trajectories(tmp_path / 'file.rrd')]
    assert len({(s['row'], s['episode']) for s in summaries}) == recorder.flights
    pause = timepoint.pause_steps(flown[0])
    recorded = {
        step for s in summaries
        for step in range(s['first_step'], s['first_step'] + s['samples'] + pause)}
    # The drawing of a flight does not change when more of it is known ...
    for entity, by_step in whole.items():
        if entity == entities.CAMERA and flown[0].world != 'lunar_lander':
            continue  # ... but for the view, which turns to a vehicle that ends lying.
        # A flight that goes on at the end was seen, but is not recorded.
        assert {step for step in live[entity] if step in recorded} == set(by_step), entity
        for step, row in by_step.items():
            for name, value in row.items():
                np.testing.assert_equal(live[entity][step][name], value, f'{entity} {step}')


def test_a_flight_is_shown_while_it_is_flown(
    tmp_path: Path, flown: tuple[WorldInfo, Samples],
) -> None:
    stage, samples = flown
    begun = samples.take(samples.step < 50)
    path = tmp_path / 'live.rrd'
    tape = Tape(path)
    recorder = Recorder(RecordingFilter(), [tape], lambda *note: None, Clock(follower.PERIOD))
    feed(recorder, (stage, begun), piece=2)
    assert recorder.flights == tape.flights == 0
    tape.close()
    poses = rows(path)[entities.ROCKET]
    # The youngest, that is the first of equals; all but its last sample, of which it is not known
    # whether it is the last.
    assert sorted(poses) == list(range(49))
    mine = begun.take(begun.row == 0)
    for step, pose in poses.items():
        np.testing.assert_allclose(
            pose['Transform3D:translation'][0], mine.values[step, 1:4], rtol=1e-6)


@pytest.mark.slow
def test_a_flight_that_breaks_off_leaves_room_for_the_next(
    tmp_path: Path, flown: tuple[WorldInfo, Samples],
) -> None:
    path = tmp_path / 'live.rrd'
    tape = Tape(path)
    recorder = Recorder(
        RecordingFilter(rows=(0,)), [tape, FileSink(tmp_path / 'file.rrd', lambda *note: None)],
        lambda *note: None, Clock(2 * follower.DWELL))
    stage, samples = flown
    feed(recorder, (stage, samples.take(samples.step < 40)))
    feed(recorder, flown, session=2)
    recorder.close()
    first = reader.trajectories(tmp_path / 'file.rrd')[0].summary
    assert first['first_step'] >= 39
    assert first['episode'] == 0
    seen = rows(path)[entities.ROCKET]
    assert set(range(39)) < set(seen)
    # The lines of the plots end between the two.
    gap = [step for step in seen if 39 <= step < first['first_step']]
    assert any(np.isnan(seen[step]['Flight:sample'][0]['motion'][0]) for step in gap)


def test_flights_that_are_not_recorded_are_not_shown_live(
    tmp_path: Path, flown: tuple[WorldInfo, Samples],
) -> None:
    tape = Tape(tmp_path / 'live.rrd')
    recorder = Recorder(
        RecordingFilter(
            every_nth_episode=1000), [tape], lambda *note: None, Clock(follower.PERIOD))
    recorder.training(Training('finetune', 1, {}))
    stage, samples = flown
    later = samples.take(samples.episode > 0)
    feed(recorder, (stage, later))
    assert np.any(later.outcome != NO_OUTCOME)
    assert tape.parts == tape.flights == 0
    looks = [Look(stage.world, training=True), Look(stage.world, training=True, unusual=True)]
    disturbed = samples.values[:, FIELDS['disturbance']].any()
    assert tape.looks == looks[:1 + int(disturbed)]


@pytest.mark.parametrize('piece', [1, 200])
def test_flights_come_in_the_order_in_which_they_ended(
    tmp_path: Path, flown: tuple[WorldInfo, Samples], piece: int,
) -> None:
    """Without a viewer, however many steps come in a message; with one all of them come, too."""
    order = []
    for live in (False, True):
        path = tmp_path / f'{live}.rrd'
        tape = Blind(tmp_path / f'{live}_live.rrd')
        tape.live = live
        recorder = Recorder(
            RecordingFilter(), [tape, FileSink(path, lambda *note: None)], lambda *note: None,
            Clock(follower.PERIOD))
        feed(recorder, flown, piece=piece)
        recorder.close()
        order.append([(f.row, f.episode) for f in reader.trajectories(path)])
    samples = flown[1]
    ended = np.flatnonzero(samples.outcome != NO_OUTCOME)
    assert order[0] == [(samples.row[k], samples.episode[k]) for k in ended]
    assert sorted(order[0]) == sorted(order[1])


def test_viewers_go_on_when_the_file_is_full(
    tmp_path: Path, flown: tuple[WorldInfo, Samples],
) -> None:
    notes: Notes = []
    tape = Tape(tmp_path / 'live.rrd')
    recorder = Recorder(
        RecordingFilter(max_steps=20), [tape, FileSink(tmp_path / 'file.rrd', lambda *note: None)],
        lambda *note: notes.append(note), Clock(follower.PERIOD))
    feed(recorder, flown)
    recorder.close()
    assert recorder.flights == recorder.steps == 0
    assert [level for level, _ in notes] == ['WARN']
    assert tape.flights > 1
    assert tape.parts > tape.flights
    assert not (tmp_path / 'file.rrd').exists()


@pytest.mark.slow
def test_training_flights_are_not_shown_once_their_room_is_used_up(
    tmp_path: Path, flown: tuple[WorldInfo, Samples],
) -> None:
    path = tmp_path / 'file.rrd'
    tape = Tape(tmp_path / 'live.rrd')
    recorder = Recorder(
        RecordingFilter(
            max_steps=100, every_nth_episode=1), [tape, FileSink(path, lambda *note: None)],
        lambda *note: None, Clock(follower.PERIOD))
    recorder.training(Training('finetune', 1, {}))
    feed(recorder, flown)
    assert recorder.flights == tape.flights == 0
    seen = tape.parts
    # One flight was followed until it was clear that there is no room for it; no other one is.
    feed(recorder, flown, session=2)
    assert tape.parts == seen
    recorder.training(Training('evaluate', 1, {}))
    feed(recorder, flown, session=3)
    recorder.close()
    assert tape.flights > 0


def test_a_new_session_is_another_flight(tmp_path: Path, flown: tuple[WorldInfo, Samples]) -> None:
    tape = Tape(tmp_path / 'live.rrd')
    recorder = Recorder(
        RecordingFilter(rows=(0,)), [tape], lambda *note: None, Clock(2 * follower.DWELL))
    stage, samples = flown
    begun = samples.take(samples.step < 30)
    feed(recorder, (stage, begun), piece=10)
    # Rocket, episode and step are the same, and there are more samples at once.
    feed(recorder, flown, session=2, piece=200)
    recorder.close()
    steps = sorted(rows(tmp_path / 'live.rrd')[entities.ROCKET])
    whole = np.flatnonzero(np.diff(steps) > 20)
    assert whole.size
    assert steps[whole[0]] <= 31
    # The second is there from its first sample on.
    first = steps[whole[0] + 1]
    assert steps[whole[0] + 1:whole[0] + 31] == list(range(first, first + 30))


def test_a_recording_closed_in_its_first_flight_holds_it_once(
    tmp_path: Path, flown: tuple[WorldInfo, Samples],
) -> None:
    stage, samples = flown
    tape = Tape(tmp_path / 'live.rrd')
    recorder = Recorder(
        RecordingFilter(), [tape, FileSink(tmp_path / 'file.rrd', lambda *note: None)],
        lambda *note: None, Clock(follower.PERIOD))
    feed(recorder, (stage, samples.take(samples.step < 50)), piece=2)
    recorder.close()
    flight, = reader.trajectories(tmp_path / 'file.rrd')
    assert flight.summary['first_step'] == 0
    assert sorted(rows(tmp_path / 'live.rrd')[entities.ROCKET]) == list(range(51))


def test_ended_flights_are_recorded_although_the_followed_one_stalls(
    tmp_path: Path, flown: tuple[WorldInfo, Samples],
) -> None:
    """Its agent may have died."""
    tape, clock = Tape(tmp_path / 'live.rrd'), Clock(0.0)
    recorder = Recorder(
        RecordingFilter(), [tape, FileSink(tmp_path / 'file.rrd', lambda *note: None)],
        lambda *note: None, clock)
    stage, samples = flown
    first = int(samples.step[samples.outcome != NO_OUTCOME][0])
    clock.now = follower.PERIOD
    feed(recorder, (stage, samples.take(samples.step <= first)), piece=1)
    waiting = int((samples.outcome[samples.step <= first] != NO_OUTCOME).sum()) - recorder.flights
    recorder.tick()
    assert recorder.flights == 0
    assert waiting > 0
    clock.now += follower.STALLED + follower.PERIOD
    recorder.tick()
    assert recorder.flights == waiting


@pytest.mark.parametrize('reported', [True, False])
def test_only_flights_during_training_are_filtered_as_training(
    tmp_path: Path, flown: tuple[WorldInfo, Samples], reported: bool,
) -> None:
    """Also for flights that wait for the followed one, and if no report ends the training."""
    tape, clock = Tape(tmp_path / 'live.rrd'), Clock(0.0)
    clock.now = follower.PERIOD
    recorder = Recorder(
        RecordingFilter(every_nth_episode=1_000_000), [tape], lambda *note: None, clock)
    stage, samples = flown
    first = int(samples.step[samples.outcome != NO_OUTCOME][0])
    feed(recorder, (stage, samples.take(samples.step <= first)), piece=1)
    recorder.training(Training('finetune', 1, {}))
    before = recorder.flights
    assert before > 0, 'they were flown before'
    later = samples.take(samples.episode > 0)
    feed(recorder, (stage, later), session=2, piece=1)
    assert recorder.flights == before
    if reported:
        recorder.training(Training('evaluate', 1, {}))
    else:
        recorder.training_is_over()
    feed(recorder, (stage, later), session=3, piece=1)
    recorder.close()
    assert recorder.flights > before


def test_the_end_of_a_flight_is_shown_before_others_follow(
    tmp_path: Path, flown: tuple[WorldInfo, Samples],
) -> None:
    tape = Blind(tmp_path / 'live.rrd')
    tape.write_trajectory = lambda put: order.append(clock.now)  # type: ignore[method-assign]
    order: list[float] = []
    clock = Clock(follower.PERIOD)
    recorder = Recorder(RecordingFilter(), [tape], lambda *note: None, clock)
    feed(recorder, flown, piece=1)
    recorder.close()
    assert len(order) > 1
    # Either at once, as it was followed, or after the end of the one followed had been seen.
    gaps = np.diff(order)
    assert (gaps[gaps > follower.PERIOD] >= follower.DWELL - 2 * follower.PERIOD).all()


@pytest.mark.slow
def test_settling_after_a_landing_is_shown_live(tmp_path: Path) -> None:
    world, samples = fly('rocket', ROCKETS, 800, brake, **SETTINGS['rocket'])
    spec = world.spec
    stage = WorldInfo.build(spec.name, spec.dt, spec.outcomes, spec.settings)
    settled: list[int] = []

    def settle(flights: Sequence[Trajectory], stage: WorldInfo) -> list[Settling | None]:
        settled.extend(flight.episode for flight in flights if flight.outcome == 'landed')
        return [
            Settling('stands', np.repeat(flight.values[-1:], 10, axis=0))
            if flight.outcome == 'landed' else None for flight in flights]

    tape = Tape(tmp_path / 'live.rrd')
    file = FileSink(tmp_path / 'file.rrd', lambda *note: None)
    recorder = Recorder(
        RecordingFilter(
            rows=(0,)), [tape, file], lambda *note: None, Clock(follower.PERIOD), settle)
    feed(recorder, (stage, samples))
    recorder.close()
    assert settled
    live, whole = rows(tmp_path / 'live.rrd'), rows(tmp_path / 'file.rrd')
    assert set(whole[entities.ROCKET]) <= set(live[entities.ROCKET])


# Real viewers

def wait(done: Callable[[], bool], seconds: float = 60.0) -> None:
    wait_until(done, seconds)


def wait_for_more(path: Path) -> int:
    """Return the size of a file after a moment."""
    time.sleep(0.5)
    return path.stat().st_size


@pytest.fixture
def port() -> int:
    """Return a free one."""
    return rerun_program.free_port()


@pytest.fixture
def start(port: int) -> Iterator[Callable[..., rerun_program.Program]]:
    """Return what starts a Rerun program that listens at the port."""
    programs = []

    def program(*arguments: str) -> rerun_program.Program:
        server = rerun_program.Program(
            *arguments, '--bind', rerun_program.LOCAL, '--port', str(port))
        programs.append(server)
        server.wait_for(
            lambda: rerun_program.reachable(rerun_program.LOCAL, port), 'the server', 20.0)
        return server

    yield program
    for server in programs:
        server.stop()


def url(port: int) -> str:
    return f'rerun+http://127.0.0.1:{port}/proxy'


def test_a_missing_viewer_does_not_block_the_recorder(
    tmp_path: Path, port: int, flown: tuple[WorldInfo, Samples],
) -> None:
    notes: Notes = []
    live = LiveSink(url(port), lambda *note: notes.append(note))
    path = tmp_path / 'run.rrd'
    recorder = Recorder(
        RecordingFilter(), [live, FileSink(path, lambda *n: None)], lambda *n: None)
    began = time.monotonic()
    feed(recorder, flown, piece=100)
    recorder.close()
    assert time.monotonic() - began < 30.0  # it would wait for ever
    assert len(notes) == 1
    assert 'no viewer at' in notes[0][1]
    assert len(reader.trajectories(path)) == recorder.flights


@pytest.mark.slow
def test_a_late_viewer_gets_the_earlier_flights(
    tmp_path: Path, port: int, flown: tuple[WorldInfo, Samples],
    start: Callable[..., rerun_program.Program],
) -> None:
    notes: Notes = []
    live = LiveSink(url(port), lambda *note: notes.append(note))
    whole = tmp_path / 'whole.rrd'
    recorder = Recorder(
        RecordingFilter(), [live, FileSink(whole, lambda *n: None)], lambda *n: None)
    recorder.training(Training('finetune', 1, {'mean_return': 1.0}, 'checkpoint saved'))
    feed(recorder, flown, piece=100)
    # Nothing happens any more; the viewer comes.
    path = tmp_path / 'seen.rrd'
    server = start('--save', str(path))
    wait(lambda: any('streaming' in text for _, text in notes), 30.0)
    recorder.close()
    live._thread.join(30.0)
    wait(lambda: path.exists() and path.stat().st_size > 50_000, 30.0)
    while path.stat().st_size != wait_for_more(path):
        pass
    server.stop()
    rerun_program.repair(path, tmp_path / 'mended.rrd')
    seen, recorded = reader.trajectories(tmp_path / 'mended.rrd'), reader.trajectories(whole)
    assert len(seen) == len(recorded) > 0
    for one, other in zip(seen, recorded, strict=True):
        assert (one.row, one.episode, one.start) == (other.row, other.episode, other.start)
        np.testing.assert_array_equal(one.position, other.position)
    assert any('checkpoint saved' in str(row) for row in rows(tmp_path / 'mended.rrd')[
        entities.LOG].values())


@pytest.mark.slow
def test_a_viewer_may_disconnect_and_reconnect(
    port: int, flown: tuple[WorldInfo, Samples], start: Callable[..., rerun_program.Program],
) -> None:
    notes: Notes = []
    live = LiveSink(url(port), lambda *note: notes.append(note), patience=0.5)
    recorder = Recorder(RecordingFilter(), [live], lambda *note: None)
    for number in (1, 2):
        server = start('--serve-grpc')
        feed(recorder, flown, session=2 * number, piece=100)
        wait(lambda number=number: sum('streaming' in text for _, text in notes) >= number)
        stopped = len(notes)
        server.stop()
        if number == 1:  # the other time it is missed although there is nothing to be sent
            feed(recorder, flown, session=2 * number + 1, piece=100)
        wait(lambda stopped=stopped: any(
            'has disconnected' in text for _, text in notes[stopped:]))
    began = time.monotonic()
    recorder.close()
    assert time.monotonic() - began < 30.0


def test_a_stalled_viewer_has_one_stream_at_a_time(
        port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rerun releases a stream only when the viewer continues, or is gone."""
    looks: list[tuple[str, int]] = []

    def look(*address: object) -> bool:
        looks.append(address)  # type: ignore[arg-type]
        return False

    monkeypatch.setattr(rerun_program, 'reachable', look)
    live = LiveSink(url(port), lambda *note: None)
    stands = threading.Event()
    live._farewell = threading.Thread(target=stands.wait, daemon=True)
    live._farewell.start()
    live.begin(lambda stream: None, Look())
    time.sleep(1.5)  # it looks for a viewer each second
    assert not looks
    stands.set()
    wait(lambda: bool(looks), 10.0)
    live.close()


@pytest.mark.parametrize('wrong', ['', '127.0.0.1:9876', 'http://127.0.0.1:9876', 'rerun://x/y'])
def test_a_wrong_url_is_refused(wrong: str) -> None:
    with pytest.raises(ValueError, match='connect: got'):
        LiveSink(wrong, lambda *note: None)


def test_an_entity_without_steps_is_refused() -> None:
    stream = Increments(cast('rr.RecordingStream', None))
    with pytest.raises(ValueError, match=r'/x: timelines sim_time, expected step'):
        stream.send_columns('/x', [rr.TimeColumn('sim_time', duration=[0.0])], [])
