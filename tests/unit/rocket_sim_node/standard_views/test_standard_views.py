# SPDX-License-Identifier: Apache-2.0
"""Standard views: stamps, twists, specific forces, models and markers, without ROS."""
from __future__ import annotations

import math
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from support.recording.recordings import fly

from rocket_sim_node import palette
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.standard_views import markers
from rocket_sim_node.standard_views.motion import MotionViews
from rocket_sim_node.standard_views.vehicle_model import vehicle_model
from rocket_sim_node.telemetry.quantities import NO_OUTCOME
from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.stamps import LATEST
from rocket_sim_node.telemetry.stamps import LATEST_TOLD
from rocket_sim_node.telemetry.stamps import SimulatedTime
from rocket_sim_node.telemetry.stamps import Stamps
from rocket_sim_node.worlds import make


def info_of(world: Any) -> WorldInfo:
    spec = world.spec
    return WorldInfo.build(spec.name, spec.dt, spec.outcomes, spec.settings, spec.condition_names)


def turning(telemetry: Any, observation: np.ndarray) -> np.ndarray:
    """Burn and turn, so that every component of every vector is other than 0."""
    return np.tile(np.float32((0.2, 0.05, -0.03)), (len(observation), 1))


def views_of(rockets: int, steps: int, **settings: Any) -> tuple[Any, Any, MotionViews]:
    world, samples = fly('rocket', rockets, steps, turning, **settings)
    views = MotionViews(range(rockets))
    views.world = info_of(world)
    return world, samples, views


def rotation_matrix(quaternion: np.ndarray) -> np.ndarray:
    """Body to world, from the definition of a quaternion by axis and angle (Rodrigues)."""
    half = math.acos(max(-1.0, min(1.0, quaternion[3])))
    axis = quaternion[:3] / max(math.sin(half), 1e-300)
    cross = np.array(((0, -axis[2], axis[1]), (axis[2], 0, -axis[0]), (-axis[1], axis[0], 0)))
    angle = 2.0 * half
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross


def test_twists_are_in_the_body_frame() -> None:
    _, samples, views = views_of(2, 60, level=7)
    moments = views.add(1, samples)
    assert len(moments) == 61
    checked = 0
    for index, view in enumerate(view for moment in moments for view in moment.rockets):
        given = samples.values[index]
        np.testing.assert_array_equal(view.position, given[FIELDS['position']])
        np.testing.assert_array_equal(view.orientation, given[FIELDS['orientation']])
        matrix = rotation_matrix(view.orientation)
        for twist, name in (
                (view.linear, 'linear_velocity'), (view.angular, 'angular_velocity')):
            np.testing.assert_allclose(matrix @ twist, given[FIELDS[name]], atol=1e-9)
        checked += not np.allclose(view.linear, given[FIELDS['linear_velocity']], atol=0.1)
    assert checked > 100  # a twist in the world frame would be noticed


def test_an_imu_measures_thrust_and_no_gravity() -> None:
    world, samples, views = views_of(1, 40, level=7, drag_coefficient=0.0)
    moments = views.add(1, samples)
    first, *rest = (view for moment in moments for view in moment.rockets)
    assert first.specific_force is None  # nothing is known of the step before the first state
    for before, view in zip((first, *rest), rest, strict=False):
        assert view.specific_force is not None
        # Semi-implicit Euler: the thrust acts along the axis of the state before.
        felt = rotation_matrix(view.orientation) @ view.specific_force
        axis = rotation_matrix(before.orientation)[:, 2]
        np.testing.assert_allclose(felt, axis * view.thrust / before.mass, atol=1e-9)
    assert world.spec.settings['gravity'] == 9.81


def test_a_lander_in_free_fall_has_no_specific_force() -> None:
    world, samples = fly(
        'lunar_lander', 1, 20, lambda telemetry, observation: np.zeros(1, np.int32))
    views = MotionViews([0])
    views.world = info_of(world)
    forces = [moment.rockets[0].specific_force for moment in views.add(1, samples)]
    assert forces[0] is None
    # Its legs swing on their springs, which moves the hull a little.
    np.testing.assert_allclose(np.median(np.array(forces[2:], float), axis=0), 0.0, atol=0.05)


def test_the_factor_of_gravity_counts() -> None:
    _, samples, views = views_of(
        1, 20, level=7, drag_coefficient=0.0, conditions='nominal',
        gravity_factor_low=2.0, gravity_factor_high=2.0)
    views_ = [moment.rockets[0] for moment in views.add(1, samples)]
    for before, view in zip(views_, views_[1:], strict=False):
        assert np.linalg.norm(view.specific_force) == pytest.approx(view.thrust / before.mass)


def test_stamps_rise_over_episodes_and_sessions() -> None:
    _, samples, views = views_of(2, 700, level=1)
    assert (samples.outcome != NO_OUTCOME).sum() >= 2
    moments = views.add(1, samples) + views.add(2, samples)
    stamps = [moment.stamp for moment in moments]
    assert np.all(np.diff(stamps) > 0)
    assert stamps[0] == 0
    assert stamps[1] == 20_000_000
    ends = [(k, view) for k, moment in enumerate(moments) for view in moment.rockets
            if view.outcome]
    assert ends
    for k, view in ends:  # the next episode begins at the same step, 1 ns later
        following = [other for other in moments[k + 1].rockets if other.row == view.row]
        assert following[0].begins
        assert moments[k + 1].stamp == moments[k].stamp + 1
    assert stamps[len(stamps) // 2] == 700 * 20_000_000 + 20_000_000  # the second session
    # A second list of the same steps is nothing new.
    assert views.add(2, samples) == []


def test_stamps_of_sessions() -> None:
    stamps = Stamps()
    assert [stamps.of(7, step, 0.02) for step in (50, 51)] == [1_000_000_000, 1_020_000_000]
    assert stamps.of(8, 3, 0.02) == 1_040_000_000
    assert stamps.of(8, 4, 0.02) == 1_060_000_000
    assert stamps.of(8, 2, 0.02) == 1_060_000_000
    assert stamps.of(9, 0, 0.5) == 1_560_000_000
    assert stamps.of(10, 7, 0.5, own_stamp=9_000_000_000) == 9_000_000_000
    assert stamps.of(10, 8, 0.5, own_stamp=5) == 9_500_000_000  # counts at the begin only
    assert stamps.of(11, 0, 0.5, own_stamp=0) == 10_000_000_000  # a simulator that was restarted
    with pytest.raises(ValueError, match='later than a stamp can say'):
        stamps.of(12, 0, 0.5, own_stamp=LATEST)


def test_stamps_of_a_simulator_are_those_of_the_views() -> None:
    """From whatever step on they are viewed, and over sessions."""
    world, samples, views = views_of(2, 60, level=7)
    time = SimulatedTime(world.spec.dt)
    late = MotionViews([0])
    late.world = views.world
    for session, ended in ((1, 0), (2, 60), (3, 60)):
        time.begin_session(ended)
        found = views.add(session, samples, time.at(60))
        assert found[0].stamp == time.at(0)
        assert found[-1].stamp == time.at(60)
        tail = late.add(session, samples.take(samples.step >= 50), time.at(60))
        assert [moment.stamp for moment in tail] == [time.at(step) for step in range(50, 61)]
    assert time.at(0) == 2 * 61 * 20_000_000
    time.restart()
    assert time.at(3) == 60_000_000
    assert views.add(4, samples, time.at(60))[0].stamp == found[-1].stamp + 20_000_000
    assert time.at(2**62) == LATEST_TOLD


def test_the_rate_is_limited_and_ends_are_kept() -> None:
    now = [0.0]
    world, samples = fly('rocket', 1, 700, turning, level=1)
    views = MotionViews([0], max_rate=10.0, clock=lambda: now[0])
    views.world = info_of(world)
    moments = views.add(1, samples)
    wanted = [
        moment for moment in moments if moment.rockets[0].outcome or moment.rockets[0].begins]
    assert len(wanted) == 2 * (samples.outcome != NO_OUTCOME).sum() + 1
    assert len(moments) <= 10 + len(wanted)
    assert views.shown + views.skipped == len(samples.step)
    gaps = np.diff([moment.stamp for moment in moments])
    assert gaps.max() <= 1.5 * 700 * 20_000_000 / 10
    everything = MotionViews([0])
    everything.world = views.world
    assert {m.stamp for m in moments} <= {m.stamp for m in everything.add(1, samples)}


def test_missed_steps_are_counted_and_their_force_is_unknown() -> None:
    _, samples, views = views_of(1, 30, level=7)
    views.add(1, samples.take(samples.step < 10))
    after = views.add(1, samples.take(samples.step >= 15))
    assert views.missed == 5
    assert after[0].rockets[0].specific_force is None
    assert after[1].rockets[0].specific_force is not None


@pytest.mark.parametrize(('spoil', 'complaint'), [
    ('orientation', 'orientation: a quaternion of length'),
    ('late step', 'step: 0 to .*, later than a stamp can say'),
    ('order', 'step: not in ascending order'),
    ('world', 'before the description of the world'),
    ('conditions', 'conditions: .* values a sample, expected 1'),
])
def test_invalid_samples_are_refused_by_name(spoil: str, complaint: str) -> None:
    world, samples, views = views_of(1, 3, level=7)
    if spoil == 'orientation':
        samples.values[2, FIELDS['orientation']] *= 2.0
    elif spoil == 'late step':
        samples.step[-1] = 2**62
    elif spoil == 'order':
        samples.step[1] = 9
    elif spoil == 'world':
        views.world = None
    else:
        spec = world.spec
        views.world = WorldInfo.build(spec.name, spec.dt, spec.outcomes, {}, ('one',))
    with pytest.raises(ValueError, match=complaint):
        views.add(1, samples)
    if spoil in ('late step', 'order'):  # what follows is not affected
        samples.step[:] = range(len(samples.step))
        assert views.add(1, samples)[0].stamp == 0


@pytest.mark.parametrize('name', ['rocket', 'rocket_planar', 'lunar_lander'])
def test_models_are_urdf(name: str) -> None:
    model = vehicle_model(info_of(make(name, 1)))
    robot = ElementTree.fromstring(model.urdf())
    links = [link.attrib['name'] for link in robot.iter('link')]
    assert robot.tag == 'robot'
    assert links == ['base_link', *(joint.link for joint in model.joints)]
    children = [child.attrib['link'] for child in robot.iter('child')]
    assert sorted(children) == sorted(links[1:])  # a tree
    assert [joint.name for joint in model.joints] == (
        ['throttle', 'left_leg', 'right_leg'] if name == 'lunar_lander' else ['throttle'])


def test_feet_of_the_model_stand_on_the_ground() -> None:
    info = info_of(make('rocket', 1))
    lowest = min(
        shape.at[2] - shape.size[-1] / 2 for shape in vehicle_model(info).shapes
        if shape.turned == (0.0, 0.0, 0.0))
    assert lowest == pytest.approx(-info.touchdown_height)


def test_legs_of_the_lander_turn_outwards() -> None:
    """As URDF has it: first the origin of the joint, then its position about its axis."""
    model = vehicle_model(info_of(make('lunar_lander', 1)))
    for joint, side in zip(model.joints[1:], (-1.0, 1.0), strict=True):
        foot = np.array(joint.shapes[0].at)
        across = []
        for position in (0.0, 0.3):
            translation, rotation = joint.transform(position)
            across.append((translation + rotation_matrix(np.array(rotation)) @ foot)[0])
        assert side * (across[1] - across[0]) > 0.0


def test_the_markers_of_a_flight() -> None:
    world, samples, views = views_of(1, 700, level=1)
    info = info_of(world)
    ends, rocket = markers.Ends(), markers.RocketMarkers(info)
    paths = []
    for moment in views.add(1, samples):
        view = moment.rockets[0]
        rocket.add(view)
        found = {marker.namespace: marker for marker in rocket.of(view)}
        assert found['flame'].hidden == (view.throttle == 0.0 or view.outcome != '')
        paths.append(len(found['path'].points))
        assert paths[-1] <= markers.PATH_POINTS
        np.testing.assert_array_equal(
            found['path'].points[0],
            view.position if view.begins else found['path'].points[0])
        if view.outcome:
            ends.add(view)
            assert view.outcome.replace('_', ' ') in found['label'].text
            np.testing.assert_array_equal(found['path'].points[-1], view.position)
    assert 1 in paths[1:]  # a new episode begins a new path
    limit = {marker.namespace: marker for marker in markers.scene(info, ends)}
    np.testing.assert_allclose(
        np.linalg.norm(limit['limit'].points, axis=1), info.landed_distance)
    known = palette.outcome_colours(info.outcomes)
    assert set(limit['outcomes'].colours) <= set(known.values())
    assert len(limit['outcomes'].points) == (samples.outcome != NO_OUTCOME).sum()
