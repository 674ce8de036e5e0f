# SPDX-License-Identifier: Apache-2.0
"""Recordings of planar worlds: legs, contact and terrain are read back unchanged."""
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.recording.recordings import fly
from support.recording.recordings import record
from support.recording.recordings import rows_of
from support.recording.recordings import view_classes

from rocket_sim_node import frames
from rocket_sim_node import palette
from rocket_sim_node.recording import reader
from rocket_sim_node.recording import screenshot
from rocket_sim_node.recording import trajectory_log
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing import planar_view
from rocket_sim_node.recording.drawing import plots
from rocket_sim_node.recording.drawing.timepoint import pause_steps
from rocket_sim_node.recording.drawing.training_plots import Training
from rocket_sim_node.recording.recorder import Recorder
from rocket_sim_node.recording.scene import lunar_lander
from rocket_sim_node.recording.scene import rocket_planar
from rocket_sim_node.recording.scene.sceneries import SCENERIES
from rocket_sim_node.recording.screenshot import ScreenshotSettings
from rocket_sim_node.recording.sinks import rerun_program
from rocket_sim_node.recording.sinks.file_sink import FileSink
from rocket_sim_node.recording.trajectories.filter import RecordingFilter
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.trajectory import TrajectoryBuffer
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.telemetry.capture import Telemetry
from rocket_sim_node.telemetry.quantities import NO_OUTCOME
from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.samples import Layout
from rocket_sim_node.telemetry.samples import Samples
from rocket_sim_node.worlds import names
from rocket_sim_node.worlds.lunar import vehicle

OUTCOMES = ('landed', 'crashed', 'out_of_bounds', 'timeout')
LUNAR = WorldInfo.build('lunar_lander', 0.02, OUTCOMES, {'field_half_width': 10.0})
PLANAR = WorldInfo.build('rocket_planar', 0.02, OUTCOMES, {'stance': 6.0, 'touchdown_height': 5.2})
LAYOUT = Layout(legs=2, heights=11)
TERRAIN = np.array((3.0, 2.0, 1.0, 0.5, 0.0, 0.0, 0.0, 1.0, 2.0, 4.0, 3.5))


def descend(episodes: int, n: int = 60, layout: Layout = LAYOUT, high: float = 9.0) -> Samples:
    """Return flights straight down that touch in their last ten samples, left foot first."""
    parts = []
    for episode in range(episodes):
        k = np.arange(n)
        touching = np.zeros((n, layout.legs))
        force = np.zeros((n, 3))
        if layout.legs:
            touching[-10:, 0] = 1.0
            touching[-5:, 1] = 1.0
            force[-10:, 2] = 50.0
        leg_angle = 0.2 * touching
        quantities = {
            'time': 0.02 * k, 'position': np.column_stack(
                (np.linspace(3.0, 1.0, n), np.zeros(n), np.linspace(high, 0.6, n))),
            'orientation': planar_view.turn(np.linspace(0.3, 0.0, n)),
            'linear_velocity': np.tile((-1.0, 0.0, -5.0), (n, 1)),
            'angular_velocity': np.zeros((n, 3)), 'torque': np.zeros((n, 3)),
            'mass': np.full(n, 50.0 / 9.81), 'fuel': np.zeros(n),
            'throttle': np.where(k % 20 < 10, 1.0, 0.0), 'thrust': np.zeros(n),
            'commanded_throttle': np.zeros(n), 'disturbance': np.zeros((n, 3)),
            'reward': np.ones(n), 'lateral_thrust': np.where(k < 30, 12.0, -12.0),
            'contact_force': force, 'contact': touching.astype(np.uint8),
            'leg_angle': leg_angle,
            'terrain': np.tile(TERRAIN[:layout.heights] * (episode + 1), (n, 1))}
        outcome = np.full(n, NO_OUTCOME)
        outcome[-1] = 0
        parts.append(Samples.build(
            k + n * episode, np.zeros(n), np.full(n, episode), outcome, **quantities))
    return Samples(*(
        np.concatenate([getattr(part, name) for part in parts])
        for name in ('step', 'row', 'episode', 'outcome', 'values')), layout)


def one_flight(layout: Layout = LAYOUT) -> Trajectory:
    return Trajectory(0, 0, 0, 'landed', descend(1, layout=layout).values, layout)


def test_own_fields_keep_their_places() -> None:
    flight = one_flight()
    assert flight.values.shape == (60, LAYOUT.width) == (60, 30 + 2 + 2 + 11)
    assert flight.contact.sum(axis=0).tolist() == [10.0, 5.0]
    np.testing.assert_array_equal(flight.leg_angle, 0.2 * flight.contact)
    np.testing.assert_array_equal(flight.terrain[7], TERRAIN)
    assert flight.lateral_thrust.shape == (60,)


@pytest.mark.parametrize(('name', 'size', 'complaint'), [
    ('contact', 5, r'contact: 5 values, expected a multiple of 2, the samples'),
    ('leg_angle', 5, r'leg_angle: 5 values, expected 4 \(2 samples x 2\)'),
    ('terrain', 7, r'terrain: 7 values, expected a multiple of 2'),
    ('contact_force', 4, r'contact_force: 4 values, expected 6 \(2 samples x 3\)'),
])
def test_wrong_samples_are_named(name: str, size: int, complaint: str) -> None:
    quantities = {
        name: np.zeros(2 * (place.stop - place.start)) for name, place in FIELDS.items()}
    quantities |= {'contact': np.zeros(4), 'leg_angle': np.zeros(4), 'terrain': np.zeros(22)}
    whole = np.zeros(2, np.int64)
    assert Samples.build(whole, whole, whole, whole, **quantities).layout == LAYOUT
    quantities[name] = np.zeros(size)
    with pytest.raises(ValueError, match=complaint):
        Samples.build(whole, whole, whole, whole, **quantities)


def test_a_buffer_takes_another_layout_from_its_start_only() -> None:
    buffer = TrajectoryBuffer(capacity=16)
    plain, legged = descend(1, layout=Layout()), descend(1)
    assert buffer.extend(plain.take(slice(0, 30)))
    assert not buffer.extend(legged.take(slice(30, 40)))
    assert buffer.extend(legged)
    np.testing.assert_array_equal(buffer.finish(0, 'landed').terrain[0], TERRAIN)
    assert buffer.extend(plain)
    assert buffer.finish(0, 'landed').terrain.shape == (60, 0)


def turn(angle: float) -> np.ndarray:
    return np.array(((np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))))


def test_legs_hang_where_gymnasium_has_them() -> None:
    """Gymnasium's leg i, -1 to the right: its centre is hull - R(hull + q_i) (20 i, 18) / 30."""
    flight = one_flight()
    for k in (0, len(flight) - 1):
        hull = float(np.linspace(0.3, 0.0, 60)[k])
        for column, (i, side) in enumerate(((1, -1.0), (-1, 1.0))):
            q = -i * (vehicle.LEG_INNER + float(flight.leg_angle[k, column]))
            expected = flight.position[k, [0, 2]] - turn(hull + q) @ (i * 20 / 30, 18 / 30)
            tip = expected + turn(hull + q) @ (0.0, -8 / 30)
            box = lunar_lander.leg(side).position[4:8].astype(np.float64)
            in_hull = frames.to_world(
                planar_view.turn(np.full(4, side * lunar_lander.turned(flight)[k, column])), box)
            drawn = flight.position[k] + frames.to_world(
                np.tile(flight.orientation[k], (4, 1)), in_hull)
            np.testing.assert_allclose(drawn.mean(axis=0)[[0, 2]], expected, atol=1e-6)
            np.testing.assert_allclose(
                lunar_lander.feet(flight)[k, column, [0, 2]], tip, atol=1e-9)


def test_feet_of_the_rocket_stand_at_its_stance() -> None:
    feet = rocket_planar.feet(one_flight(), PLANAR)
    np.testing.assert_allclose(feet[-1], [[1 - 6, 0, 0.6 - 5.2], [1 + 6, 0, 0.6 - 5.2]])
    assert feet[0, 0, 2] < feet[0, 1, 2], 'turned to the left the left foot is the lower one'


def test_the_file_holds_terrain_legs_and_puffs_of_a_lander(tmp_path: Path) -> None:
    path = tmp_path / 'run.rrd'
    record(path, LUNAR, descend(2))
    rerun_program.verify(path)
    second = 60 + pause_steps(LUNAR)
    ground = rows_of(path, entities.TERRAIN, 'Mesh3D:vertex_positions')
    assert [step for step, _ in ground] == [0, second]
    for number, (_, vertices) in enumerate(ground, 1):
        top = np.array(vertices)[1:12]
        np.testing.assert_allclose(top[:, 0], np.linspace(-10, 10, 11))
        np.testing.assert_allclose(top[:, 2], number * TERRAIN, rtol=1e-6)
    for leg, side, touched in zip(entities.LEGS, (-1.0, 1.0), (50, 55), strict=True):
        turns = dict(rows_of(path, leg, 'Transform3D:quaternion'))
        assert list(turns) == [0, touched, second, second + touched]
        for step, angle in ((0, 0.0), (touched, 0.2)):
            # Outwards is counter-clockwise, about -y, for the right leg.
            half = side * (vehicle.LEG_INNER + angle) / 2
            assert turns[step][0] == pytest.approx([0, -np.sin(half), 0, np.cos(half)])
    puffs = rows_of(path, entities.PUFF, 'Transform3D:quaternion')
    assert puffs[0][1][0] == pytest.approx([0, -1, 0, 0], abs=1e-6), 'pushed right, blown left'
    assert puffs[1][0] == 30
    assert puffs[1][1][0] == pytest.approx([0, 0, 0, 1])


def test_the_wind_of_a_lander_is_an_arrow_and_a_plot(tmp_path: Path) -> None:
    world, samples = fly(
        'lunar_lander', 1, 40, lambda _, seen: np.zeros(len(seen), np.int64), enable_wind=True)
    path, spec = tmp_path / 'wind.rrd', world.spec
    record(path, WorldInfo.build(spec.name, spec.dt, spec.outcomes, spec.settings), samples)
    rerun_program.verify(path)
    vectors = [
        vectors[0] for _, vectors in rows_of(path, entities.DISTURBANCE, 'Arrows3D:vectors')[:-1]]
    wind = samples.values[:, FIELDS['disturbance']]
    assert np.abs(wind[1:, 0]).min() > 0.0
    np.testing.assert_allclose(
        np.linalg.norm(vectors, axis=1), 5.0 * LUNAR.scale * np.abs(wind[:, 0]), atol=1e-4)
    unusual = rows_of(path, entities.ROCKET, plots.UNUSUAL)[:-1]
    plotted = np.array([records[0]['disturbance'] for _, records in unusual], np.float64)
    np.testing.assert_allclose(plotted, wind[:, :2], rtol=1e-3)


def test_contact_lights_up_and_goes_out(tmp_path: Path) -> None:
    path = tmp_path / 'run.rrd'
    record(path, LUNAR, descend(2))
    lit = {step: len(feet) for step, feet in rows_of(
        path, entities.CONTACT, 'Points3D:positions')}
    clear = 60 + pause_steps(LUNAR) - 1
    assert lit[50] == 1
    assert lit[55] == 2
    assert lit[clear] == 0
    assert min(lit) == 50
    arrows = dict(rows_of(path, entities.CONTACT, 'Arrows3D:vectors'))
    # A force of one weight.
    assert arrows[50][0] == pytest.approx([0.0, 0.0, 2.0 * LUNAR.unit])
    assert arrows[clear] == []


def test_no_contact_costs_nothing(tmp_path: Path) -> None:
    samples = descend(1)
    samples.values[:, LAYOUT.place('contact')] = 0.0
    samples.values[:, FIELDS['contact_force']] = 0.0
    record(tmp_path / 'run.rrd', LUNAR, samples)
    assert rows_of(tmp_path / 'run.rrd', entities.CONTACT, 'Points3D:positions') == []


def test_the_training_timeline_shows_a_lander_on_its_terrain(tmp_path: Path) -> None:
    path = tmp_path / 'run.rrd'
    recorder = Recorder(
        RecordingFilter(), [FileSink(path, lambda *note: None)], lambda *note: None)
    # Before the world is known, as it may happen on the wire.
    recorder.training(Training('finetune', 1, {'mean_return': 1.0}))
    recorder.world(LUNAR)
    recorder.states(1, descend(1))
    recorder.close()
    rerun_program.verify(path)
    for entity, component in (
            (entities.TERRAIN, 'Mesh3D:vertex_positions'),
            (entities.CAMERA, 'Transform3D:translation'),
            (entities.ROCKET, 'Transform3D:translation'),
            (entities.LEGS[0], 'Transform3D:quaternion')):
        assert len(rows_of(path, entity, component, timeline='iteration')) == 1
    assert '2D' in view_classes(path)
    assert view_classes(path).count('TimeSeries') > len(SCENERIES['lunar_lander'].plots)


@pytest.mark.parametrize(('stage', 'layout'), [(LUNAR, LAYOUT), (PLANAR, Layout(legs=2))])
def test_flights_are_read_back(tmp_path: Path, stage: WorldInfo, layout: Layout) -> None:
    path = tmp_path / 'run.rrd'
    samples = descend(2, layout=layout)
    record(path, stage, samples)
    flights = reader.trajectories(path)
    assert [flight.outcome for flight in flights] == ['landed', 'landed']
    for number, flight in enumerate(flights):
        given = samples.values[samples.episode == number]
        np.testing.assert_array_equal(
            flight.position, given[:, FIELDS['position']].astype(np.float32))
        np.testing.assert_allclose(
            flight.velocity, given[:, FIELDS['linear_velocity']], atol=1e-5)
        np.testing.assert_allclose(flight.throttle, given[:, FIELDS['throttle']][:, 0])
        if stage is LUNAR:
            assert not flight.fuel.any(), 'a lander has no fuel, but side engines'


def test_each_world_has_its_view(tmp_path: Path) -> None:
    assert set(names()) <= set(SCENERIES)
    for world, kind in (
            ('rocket', '3D'), ('rocket_planar', '2D'), ('lunar_lander', '2D'),
            ('of_tomorrow', '3D')):
        path = tmp_path / f'{world}.rrd'
        layout = LAYOUT if world == 'lunar_lander' else Layout(legs=2)
        record(path, WorldInfo.build(world, 0.02, OUTCOMES, {}), descend(1, layout=layout))
        assert {'2D', '3D'} & set(view_classes(path)) == {kind}
        plots = view_classes(path).count('TimeSeries')
        assert plots == len(SCENERIES.get(world, SCENERIES['rocket']).plots)


def test_the_phase_is_settling_after_contact() -> None:
    flight = one_flight()
    flight.values[:, FIELDS['throttle']] = 0.0
    assert trajectory_log.phases(flight) == [(0, 'fall'), (50, 'settling'), (59, 'landed')]


def test_marks_lie_on_the_ground() -> None:
    flight = one_flight()
    # At x = 1 the terrain is half way between its sixth and seventh point, both 0.
    assert trajectory_log.touchdown(flight, LUNAR)[2] == pytest.approx(0.25 * LUNAR.scale)
    flight.values[:, FIELDS['position'].start] = 9.0
    ground = (4.0 + 3.5) / 2
    flight.values[-1, FIELDS['position'].start + 2] = ground + 1.0
    assert trajectory_log.touchdown(flight, LUNAR, 2.0)[2] == pytest.approx(
        ground + 0.25 * LUNAR.scale)
    flight.values[-1, FIELDS['position'].start + 2] = 9.0
    assert trajectory_log.touchdown(flight, LUNAR, 2.0)[2] == 9.0


def test_the_field_fills_the_view() -> None:
    x, y, z, height = lunar_lander.frame(np.array((7.0, 0.0, 9.0)), LUNAR)
    assert (x, y) == (0.0, 0.0)
    assert height * lunar_lander.ASPECT == pytest.approx(20.0)
    assert z + height / 2 == pytest.approx(10.0)


def test_outcomes_of_any_world_differ_in_colour() -> None:
    for outcomes in (OUTCOMES, ('landed', 'toppled', 'too_fast', 'slid', 'hull', 'timeout')):
        colours = palette.outcome_colours(outcomes)
        assert tuple(colours) == outcomes
        assert len(set(colours.values())) == len(outcomes)
        assert colours['landed'] == palette.GREEN


def test_the_picture_of_a_low_flight_is_taken_near_the_ground(tmp_path: Path) -> None:
    path = tmp_path / 'run.rrd'
    record(path, LUNAR, descend(1))
    flights = reader.trajectories(path)
    when = screenshot.moment(ScreenshotSettings(str(path), at='burn'), flights)
    height = np.interp(when, flights[0].time, flights[0].position[:, 2])
    assert 0.6 < height < 0.6 + 0.3 * 8.4


def lunar_pilot(state: Telemetry, observation: np.ndarray) -> np.ndarray:
    """Steer about upright towards the pad, after Gymnasium's demonstration pilot."""
    x, y, vx, vy, angle, spin, right, left = observation.T
    turn = 0.5 * (np.clip(0.5 * x + vx, -0.4, 0.4) - angle) - spin
    lift = 0.5 * (0.55 * np.abs(x) - y) - 0.5 * vy
    grounded = (left > 0) | (right > 0)
    turn = np.where(grounded, 0.0, turn)
    lift = np.where(grounded, -0.5 * vy, lift)
    action = np.where(turn < -0.05, 3, np.where(turn > 0.05, 1, 0))
    return np.where((lift > np.abs(turn)) & (lift > 0.05), 2, action).astype(np.int32)


def braking_pilot(state: Telemetry, observation: np.ndarray) -> np.ndarray:
    """Brake in time, all but the last."""
    height = np.maximum(state.position[:, 1] - 5.2, 0.05)
    fall = -state.linear_velocity[:, 1]
    wanted = state.mass * (9.81 + fall**2 / (2 * height)) / 470_880
    burn = (fall > np.sqrt(10 * height) + 0.5) | (state.throttle > 0)
    burn[-1] = False
    action = np.zeros((len(height), 3), np.float32)
    action[:, 0] = np.clip(2 * np.where(burn, wanted, 0.0) - 1, -1, 1)
    return action


@pytest.mark.slow
@pytest.mark.parametrize(('world', 'pilot', 'settings'), [
    ('lunar_lander', lunar_pilot, {}),
    ('rocket_planar', braking_pilot, {'level': 1, 'spawn_angle': 0.3})])
def test_size(
    tmp_path: Path, world: str, pilot: object, settings: dict[str, float],
) -> None:
    sizes, steps = [], []
    for name, count in (('few', 700), ('many', 3500)):
        simulated, samples = fly(world, 4, count, pilot, **settings)  # type: ignore[arg-type]
        spec = simulated.spec
        stage = WorldInfo.build(world, spec.dt, spec.outcomes, spec.settings)
        recorder = record(tmp_path / f'{name}.rrd', stage, samples)
        sizes.append((tmp_path / f'{name}.rrd').stat().st_size)
        steps.append(recorder.steps)
    assert sizes[1] / steps[1] <= 150 * 1024 / 1000
    each = (sizes[1] - sizes[0]) / (steps[1] - steps[0])
    assert each <= 110 * 1024 / 1000
    assert sizes[0] - each * steps[0] <= 230 * 1024, 'layout, meshes and index'
