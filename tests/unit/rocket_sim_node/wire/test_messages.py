# SPDX-License-Identifier: Apache-2.0
"""Messages to arrays and back, and the two frames."""
from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rocket_msgs.msg import Action
from rocket_msgs.msg import Episodes as EpisodesMessage
from rocket_msgs.msg import Setting
from rocket_msgs.msg import World
from scipy.spatial.transform import Rotation

from rocket_sim_node import frames
from rocket_sim_node import worlds
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.wire.messages.cdr import Codec


def test_a_world_is_unchanged_by_its_message() -> None:
    spec = worlds.make('rocket', num_envs=3, level=2, dt=0.01).spec
    assert conversion.world_from_message(conversion.world_to_message(spec, 1, 0, 0)) == spec


def test_episodes_are_unchanged_by_their_message() -> None:
    world = worlds.make('rocket', num_envs=64, seed=1)
    for _ in range(400):
        episodes = world.step(np.tile([-1.0, 0.0, 0.0], (64, 1)))[4]['episodes']
        if len(episodes):
            break
    codec = Codec(EpisodesMessage)
    back = conversion.episodes_from_message(
        codec.decode(codec.encode((1, 2), conversion.episode_arrays(episodes))))
    for name in episodes.__dataclass_fields__:
        ours, theirs = getattr(episodes, name), getattr(back, name)
        assert ours.dtype == theirs.dtype
        np.testing.assert_array_equal(ours, theirs)


def test_actions_of_the_wrong_kind_or_number_are_named() -> None:
    spec = worlds.make('rocket', num_envs=2).spec

    def action(continuous: list[float], discrete: list[int] | None = None) -> Any:
        codec = Codec(Action)
        return codec.decode(codec.encode(
            (1, 2, 3), (np.array(continuous), np.array(discrete or ()))))

    with pytest.raises(ValueError, match=r'continuous: 5 values, expected 6 \(2 rockets x 3\)'):
        conversion.action_from_message(action([0.0] * 5), spec)
    with pytest.raises(ValueError, match='discrete: 2 values, expected none'):
        conversion.action_from_message(action([], [1, 2]), spec)
    good = conversion.action_from_message(action([0.0, 1.0, 2.0] * 2), spec)
    np.testing.assert_array_equal(good, [[0, 1, 2]] * 2)


def test_a_setting_given_twice_is_refused() -> None:
    twice = [Setting(name='level', value=1.0), Setting(name='level', value=2.0)]
    with pytest.raises(ValueError, match='twice'):
        conversion.settings_from_message(twice)


def test_settings_have_units_and_another_unit_is_refused() -> None:
    for name in worlds.names():
        spec = worlds.make(name, 2).spec
        units = worlds.units(name)
        assert units.keys() >= spec.settings.keys()
        message = conversion.world_to_message(spec, 1, 0, World.LOCKSTEP)
        assert {one.name: one.unit for one in message.settings} == {
            setting: units[setting] for setting in spec.settings}
    assert (units['wind_power'], worlds.units('rocket')['spawn_angle']) == ('N', 'deg')
    units = worlds.units('rocket')
    for unit in ('', 'deg'):
        given = [Setting(name='spawn_angle', value=5.0, unit=unit)]
        assert conversion.settings_from_message(given, units) == {'spawn_angle': 5.0}
    with pytest.raises(ValueError, match=(
            "settings: unit of 'spawn_angle': got 'rad', expected 'deg' or none")):
        conversion.settings_from_message(
            [Setting(name='spawn_angle', value=0.1, unit='rad')], units)
    with pytest.raises(ValueError, match="'level': got 'm', expected '' or none"):
        conversion.settings_from_message([Setting(name='level', unit='m')], units)


def test_up_becomes_z_and_the_frames_stay_right_handed() -> None:
    axes = np.eye(3)
    x, y, z = frames.vector_to_ros(axes)
    np.testing.assert_array_equal(y, [0, 0, 1])
    np.testing.assert_array_equal(np.cross(x, y), z)
    np.testing.assert_array_equal(frames.vector_from_ros(frames.vector_to_ros(axes)), axes)


def test_the_nose_points_the_same_way_in_both_frames() -> None:
    """Rotating the body's axis in one frame and converting is converting and rotating."""
    random = np.random.default_rng(1)
    quaternion = Rotation.random(50, rng=random).as_quat()
    ours = Rotation.from_quat(quaternion).apply([0.0, 1.0, 0.0])
    theirs = Rotation.from_quat(frames.quaternion_to_ros(quaternion)).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(frames.vector_to_ros(ours), theirs, atol=1e-12)
