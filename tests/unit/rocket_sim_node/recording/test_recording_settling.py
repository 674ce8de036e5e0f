# SPDX-License-Identifier: Apache-2.0
"""Settling after a touchdown is recorded after the flight, with its verdict."""
from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from support.recording import rendering
from support.recording.recordings import lines_of
from support.recording.recordings import record
from support.recording.recordings import rows_of

from rocket_sim_node import worlds
from rocket_sim_node.recording import reader
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing import planar_view
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.drawing.timepoint import pause_steps
from rocket_sim_node.recording.drawing.training_plots import Training
from rocket_sim_node.recording.recorder import HELD
from rocket_sim_node.recording.recorder import MOST_HELD
from rocket_sim_node.recording.recorder import Recorder
from rocket_sim_node.recording.scene import camera
from rocket_sim_node.recording.scene import rocket_model
from rocket_sim_node.recording.sinks import rerun_program
from rocket_sim_node.recording.sinks.file_sink import FileSink
from rocket_sim_node.recording.trajectories import touchdown
from rocket_sim_node.recording.trajectories.filter import RecordingFilter
from rocket_sim_node.recording.trajectories.trajectory import Settling
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.recording.trajectory_log import log_flight
from rocket_sim_node.telemetry.quantities import NO_OUTCOME
from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.samples import WIDTH
from rocket_sim_node.telemetry.samples import Layout
from rocket_sim_node.telemetry.samples import Samples
from rocket_sim_node.worlds.rocket.outcome import OUTCOMES

STAGE = WorldInfo('rocket', 0.02, ('landed', 'too_fast'), settings={'dry_mass': 22_000.0})
FLIGHT, AFTER = 100, 150


def two_flights() -> Samples:
    """Return two flights straight down, the first of which lands."""
    values = np.zeros((FLIGHT, WIDTH))
    values[:, FIELDS['time'].start] = 0.02 * np.arange(FLIGHT)
    values[:, FIELDS['position'].stop - 1] = np.linspace(60.0, 5.2, FLIGHT)
    values[:, FIELDS['orientation'].stop - 1] = 1.0
    values[:, FIELDS['mass']] = 22_000.0
    values[:, FIELDS['throttle']] = 0.7
    values[:, FIELDS['reward']] = 1.0
    outcome = np.full(2 * FLIGHT, NO_OUTCOME)
    outcome[[FLIGHT - 1, 2 * FLIGHT - 1]] = 0, 1
    return Samples(
        np.arange(2 * FLIGHT), np.zeros(2 * FLIGHT, np.int64),
        np.repeat((0, 1), FLIGHT), outcome, np.concatenate((values, values)))


def topple(flights: Sequence[Trajectory], stage: WorldInfo) -> list[Settling | None]:
    """Tip rockets that landed over to the right, about a foot at 6.7 m; leave the others alone."""
    return [toppled(stage) if flight.outcome == 'landed' else None for flight in flights]


def toppled(stage: WorldInfo) -> Settling:
    """Return a fall to the right about a foot at 6.7 m."""
    assert stage.settings['dry_mass'] == 22_000.0
    angle = np.linspace(0.0, 0.5 * np.pi, AFTER)
    foot = np.array((6.7, 0.0, 0.0))
    arm = np.stack((
        -6.7 * np.cos(angle) + 5.2 * np.sin(angle), 0 * angle,
        6.7 * np.sin(angle) + 5.2 * np.cos(angle)), axis=1)
    force = np.zeros((AFTER, 3))
    force[:, 2] = 22_000.0 * 9.81
    return Settling.build(
        'tips_over', foot + arm, planar_view.turn(-angle), contact_force=force)


@pytest.fixture
def settled(tmp_path: Path) -> Path:
    """Record two flights, of which the first settles."""
    path = tmp_path / 'run.rrd'
    recorder = record(path, STAGE, two_flights(), topple)
    assert recorder.steps == 2 * FLIGHT + AFTER
    rerun_program.verify(path)
    return path


def test_settling_does_not_change_the_flights(settled: Path) -> None:
    first, second = reader.trajectories(settled)
    assert len(first.time) == len(second.time) == FLIGHT
    assert first.position[-1, 2] == pytest.approx(5.2)
    assert first.summary['return'] == FLIGHT - 1
    assert first.summary['tilt'] == 0.0
    assert (first.summary['verdict'], first.summary['settled']) == ('tips_over', AFTER)
    assert (second.summary['verdict'], second.summary['settled']) == ('', 0)
    assert second.start == pytest.approx(0.02 * (FLIGHT + AFTER + pause_steps(STAGE)))


def test_the_vehicle_moves_while_it_settles(settled: Path) -> None:
    poses = dict(rows_of(settled, entities.ROCKET, 'Transform3D:translation'))
    settling = toppled(STAGE)
    for k in (0, 50, AFTER - 1):
        np.testing.assert_allclose(
            poses[FLIGHT + k][0], settling.values[k, FIELDS['position']], atol=1e-5)
    tilt = dict(lines_of(settled, entities.ROCKET, 'tilt'))
    assert tilt[FLIGHT + AFTER - 1][0] == pytest.approx(90.0)
    assert np.isnan(tilt[FLIGHT + AFTER][0]), 'a gap ends the lines'


def test_without_a_viewer_landings_wait_for_others(tmp_path: Path) -> None:
    """They settle together: when there are many, some seconds after the first, at the end."""
    asked: list[int] = []
    worlds_asked: list[WorldInfo] = []

    def settle(flights: Sequence[Trajectory], stage: WorldInfo) -> list[Settling | None]:
        asked.append(len(flights))
        worlds_asked.append(stage)
        return topple(flights, stage)

    def fly(session: int) -> None:
        recorder.states(session, dataclasses.replace(
            two_flights(), step=np.arange(2 * FLIGHT) + 1000 * session))

    now = 0.0
    path = tmp_path / 'run.rrd'
    sink = FileSink(path, lambda *note: None)
    recorder = Recorder(RecordingFilter(), [sink], lambda *note: None, lambda: now, settle)
    recorder.world(STAGE)
    fly(1)
    recorder.tick()
    assert asked == []
    now = HELD
    recorder.tick()
    assert asked == [2]
    for session in range(2, 2 + MOST_HELD // 2 + 1):
        fly(session)
    assert asked == [2, MOST_HELD + 1]
    # Of a world that is another one, others will settle in another way.
    recorder.world(dataclasses.replace(STAGE, settings={'dry_mass': 22_000.0, 'gravity': 1.6}))
    assert asked == [2, MOST_HELD + 1, 1]
    assert worlds_asked == [STAGE] * 3
    # Flights of a training do not settle, and are recorded at once.
    fly(100)
    recorder.training(Training('finetune', 1, {}))
    assert asked == [2, MOST_HELD + 1, 1, 2]
    fly(101)
    assert recorder.flights == 2 + MOST_HELD + 1 + 1 + 2 + 1  # of the last only every fifth
    # An agent that was killed is no agent, and comes back in the stage that it was in.
    recorder.training_is_over()
    fly(102)
    recorder.training(Training('finetune', 2, {}))
    assert asked == [2, MOST_HELD + 1, 1, 2, 2]
    recorder.close()
    assert asked == [2, MOST_HELD + 1, 1, 2, 2]
    flights = reader.trajectories(path)
    assert [flight.summary['settled'] for flight in flights] == [AFTER, 0] * 11 + [0, AFTER, 0]
    order = [flight.summary['simulator_step'] for flight in flights]
    assert order == sorted(order)
    assert len(set(order)) == len(order)


def test_reports_come_after_the_flights_before_them(tmp_path: Path) -> None:
    path = tmp_path / 'run.rrd'
    recorder = Recorder(
        RecordingFilter(), [FileSink(path, lambda *note: None)], lambda *note: None, settle=topple)
    recorder.world(STAGE)
    recorder.training(Training('evaluate', 1, {}))
    recorder.states(1, two_flights())
    recorder.training(Training('evaluate', 1, {}, 'flown'))
    recorder.states(2, two_flights())
    recorder.training(Training('done', 1, {}))
    recorder.close()
    steps = dict((text[0], step) for step, text in rows_of(path, entities.LOG, 'TextLog:text'))
    flights = reader.trajectories(path)
    ends = [flight.summary['first_step'] + flight.summary['samples'] for flight in flights]
    assert len(ends) == 4
    flown, done = (
        next(step for text, step in steps.items() if word in text) for word in ('flown', 'done'))
    assert ends[1] <= flown < ends[2]
    assert done >= ends[3]


def test_room_that_ends_amid_flights_that_settle_together(tmp_path: Path) -> None:
    path = tmp_path / 'run.rrd'
    recorder = Recorder(
        RecordingFilter(max_steps=3 * FLIGHT + AFTER), [FileSink(path, lambda *note: None)],
        lambda *note: None, settle=topple)
    recorder.world(STAGE)
    for session in range(1, 4):
        recorder.states(session, two_flights())
    recorder.close()
    assert recorder.steps == 3 * FLIGHT + AFTER - FLIGHT
    assert [flight.summary['settled'] for flight in reader.trajectories(path)] == [AFTER, 0]


def test_the_verdict_is_shown_and_logged(settled: Path) -> None:
    states = [
        (step, state[0]) for step, state in rows_of(settled, entities.PHASE, 'StateChange:state')]
    end = FLIGHT + AFTER - 1
    assert states[:5] == [
        (0, 'burn'), (FLIGHT - 1, 'landed'), (FLIGHT, 'settling'), (end, 'tips_over'),
        (end + pause_steps(STAGE) - 1, 'tips_over')]
    assert states[-1][1] == 'too_fast'
    labels = dict(rows_of(settled, entities.PHASE, 'Points3D:labels'))
    assert labels[end][0].startswith('landed, tips over\n')
    assert not labels[FLIGHT - 1]
    texts = [text[0] for _, text in rows_of(settled, entities.LANDINGS, 'TextLog:text')]
    assert 'episode 0: landed, tips over, ' in texts[0]
    assert 'episode 1: too fast, ' in texts[1]


def test_the_ground_pushes_until_the_next_flight(settled: Path) -> None:
    arrows = dict(rows_of(settled, entities.CONTACT, 'Arrows3D:vectors'))
    assert min(arrows) == FLIGHT
    assert arrows[FLIGHT][0] == pytest.approx([0.0, 0.0, 2.0 * STAGE.unit])
    assert arrows[FLIGHT + AFTER + pause_steps(STAGE) - 1] == []


def test_nothing_is_added_where_nothing_settles(tmp_path: Path) -> None:
    def nothing(flights: Sequence[Trajectory], stage: WorldInfo) -> list[Settling | None]:
        return [None] * len(flights)

    for name, settle in (('with', nothing), ('without', None)):
        record(tmp_path / f'{name}.rrd', STAGE, two_flights(), settle)
    for entity, component in (
            (entities.ROCKET, 'Transform3D:translation'), (entities.PHASE, 'StateChange:state')):
        assert (rows_of(tmp_path / 'with.rrd', entity, component)
                == rows_of(tmp_path / 'without.rrd', entity, component))
    assert rows_of(tmp_path / 'without.rrd', entities.CONTACT, 'Arrows3D:vectors') == []


def test_a_settling_that_does_not_fit_is_named(tmp_path: Path) -> None:
    still = np.zeros((4, 3)), np.tile((0.0, 0.0, 0.0, 1.0), (4, 1))
    with pytest.raises(ValueError, match='settling: torque has 4 values, expected 12'):
        Settling.build('stands', *still, torque=np.zeros(4))
    with pytest.raises(ValueError, match="settling: unknown quantity 'colour'"):
        Settling.build('stands', *still, colour=np.zeros(4))
    flight = Trajectory(0, 0, 0, 'landed', two_flights().values[:FLIGHT])
    wide = Settling.build('stands', *still, layout=Layout(legs=2))
    with pytest.raises(ValueError, match=r'settling: samples are \(34,\) wide, expected \(30,\)'):
        log_flight(None, flight, STAGE, Timepoint(0), wide)  # type: ignore[arg-type]


@pytest.mark.slow
def test_picture(settled: Path) -> None:
    """The band of the body is high in the picture at touchdown, and low when it has toppled."""
    times = [0.02 * (FLIGHT + 1), 0.02 * (FLIGHT + AFTER) + 1.0]
    rows = []
    for pixels in rendering.pictures(settled, times):
        band = rendering.of_vehicle(pixels[60:, :pixels.shape[1] // 2], 'rocket')
        assert band.sum() > 30
        rows.append(float(np.mean(np.nonzero(band)[0])))
    assert rows[1] > rows[0] + 50


def test_the_view_holds_a_toppled_vehicle() -> None:
    flight = Trajectory(0, 0, 0, 'landed', two_flights().values[:FLIGHT])
    settling = toppled(STAGE)
    whole = flight.followed_by(settling)
    assert len(whole) == FLIGHT + AFTER
    assert flight.followed_by(None) is flight
    view = camera.shots(whole, STAGE)[-1]
    ends = whole.position[-1] + np.array(((0.0,), (rocket_model.NOSE,))) * whole.up[-1]
    assert ends[1, 0] == pytest.approx(6.7 + 5.2 + rocket_model.NOSE)
    assert np.all(np.abs(ends - view[:3]) < view[3] / 2)
    standing = camera.shots(flight, STAGE)[-1]
    assert ends[1, 0] > standing[0] + standing[3] / 2, 'the shot of a landing would not do'


def landing(lean: float, outcome: str = 'landed') -> Trajectory:
    """Return a flight that ends at the ground, leaning towards world y by `lean`, rad."""
    values = np.zeros((50, WIDTH))
    values[:, FIELDS['position']] = np.stack(
        (np.full(50, 3.0), np.zeros(50), np.linspace(6.0, 5.2, 50)), axis=1)
    # About x by minus the lean the nose goes to +y.
    values[:, FIELDS['orientation']] = (-np.sin(lean / 2), 0, 0, np.cos(lean / 2))
    values[:, FIELDS['linear_velocity']] = (0, 0, -0.5)
    values[:, FIELDS['mass']], values[:, FIELDS['fuel']] = 23_000.0, 1_000.0
    return Trajectory(0, 0, 0, outcome, values)


REAL = WorldInfo.build('rocket', 0.02, OUTCOMES, worlds.make('rocket').spec.settings)


def test_a_landing_is_followed_by_the_contact_model() -> None:
    """It goes on where the flight ended, rights itself and stands in its place."""
    flight = landing(np.deg2rad(4.0))
    settling, = touchdown.follow([flight], REAL)
    assert settling is not None
    assert settling.verdict in ('stands', 'bounces')
    after = Trajectory(0, 0, 0, 'landed', settling.values)
    assert after.position[0] == pytest.approx(flight.position[-1], abs=0.6)
    assert after.tilt[0] == pytest.approx(4.0, abs=0.3)
    assert after.up[0, 1] > 0.06
    assert after.tilt[-1] == pytest.approx(0.0, abs=0.1)
    assert after.position[-1, 2] == pytest.approx(5.2, abs=0.01)
    assert after.position[-1, :2] == pytest.approx((3.0, 0.0), abs=0.5)
    assert (after.fuel == 1_000.0).all()
    assert len(after) > 25


def test_mass_and_gravity_are_those_of_the_flight() -> None:
    """A third of the gravity lets it fall 9 times less before it touches, and rock longer."""
    names = ('mass_factor', 'gravity_factor')
    stage = WorldInfo.build('rocket', 0.02, OUTCOMES, REAL.settings, names)
    layout = Layout(conditions=2)

    def drawn(gravity: float, mass: float = 23_000.0) -> Settling:
        plain = landing(np.deg2rad(6.0)).values
        values = np.concatenate((plain, np.tile((1.0, gravity), (len(plain), 1))), axis=1)
        values[:, FIELDS['mass']] = mass
        settling, = touchdown.follow([Trajectory(0, 0, 0, 'landed', values, layout)], stage)
        assert settling is not None
        return settling

    nominal, = touchdown.follow([landing(np.deg2rad(6.0))], REAL)
    assert nominal is not None
    same = drawn(1.0)
    np.testing.assert_array_equal(same.values[:, :WIDTH], nominal.values)
    assert len(drawn(0.3).values) > 1.3 * len(same.values)
    heavy = drawn(1.0, 26_000.0)
    assert not np.allclose(heavy.values[5], same.values[5])
    assert (heavy.values[:, FIELDS['mass']] == 26_000.0).all()


def test_only_landings_of_rocket_are_followed() -> None:
    others = [landing(0.0, 'timeout'), landing(0.0, 'too_fast')]
    assert touchdown.follow(others, REAL) == [None, None]
    other = WorldInfo.build('rocket_planar', 0.02, OUTCOMES, REAL.settings)
    assert touchdown.follow([landing(0.0)], other) == [None]
    assert touchdown.follow([], REAL) == []


def test_landings_that_settle_together_do_so_as_each_alone() -> None:
    """As long as each alone, to what the solver's rounding leaves."""
    flights = [landing(np.deg2rad(lean)) for lean in (0.0, 4.0, 9.0)]
    flights.insert(1, landing(0.0, 'timeout'))
    together = touchdown.follow(flights, REAL)
    lengths = set()
    for flight, settling in zip(flights, together, strict=True):
        alone, = touchdown.follow([flight], REAL)
        if settling is None:
            assert alone is None
            continue
        assert alone is not None
        assert settling.verdict == alone.verdict
        np.testing.assert_allclose(settling.values, alone.values, atol=1e-6)
        lengths.add(len(settling.values))
    assert len(lengths) == 3


def test_landings_do_not_settle_during_training(tmp_path: Path) -> None:
    """Training does not need it, and it would take time from the training."""
    asked: list[Trajectory] = []

    def settle(flight: Trajectory, stage: WorldInfo) -> Settling | None:
        asked.append(flight)
        return None

    recorder = Recorder(
        RecordingFilter(every_nth_episode=1), [], lambda level, text: None, settle=settle)
    recorder.world(STAGE)
    recorder.training(Training('finetune', 1, {}))
    recorder.states(1, two_flights())
    assert recorder.flights == 2
    assert not asked
