# SPDX-License-Identifier: Apache-2.0
"""The extended observation: past actions and accelerations beside the 15 numbers."""
from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rocket_sim_node import worlds
from rocket_sim_node.worlds.rocket.world import RocketWorld

BOTH = pytest.mark.parametrize('name', ['rocket', 'rocket_planar'])


def make(name: str, num_envs: int = 6, **settings: Any) -> RocketWorld:
    """Return a world with extended observations."""
    world = worlds.make(name, num_envs, seed=3, observation='extended', **settings)
    assert isinstance(world, RocketWorld)
    return world


@BOTH
def test_columns_are_named(name: str) -> None:
    """36 of them, newest first; the setting is sent as a number and read back as a word."""
    spec = make(name).spec
    assert spec.observation_size == 36
    assert spec.observation_names[:15] == worlds.make(name).spec.observation_names
    assert spec.observation_names[15:19] == (
        'command_1_throttle', 'command_1_rcs_x', 'command_1_rcs_z', 'command_2_throttle')
    assert spec.observation_names[30:] == (
        'acceleration_1_x', 'acceleration_1_y', 'acceleration_1_z',
        'acceleration_2_x', 'acceleration_2_y', 'acceleration_2_z')
    assert spec.settings['observation'] == 1
    assert all(isinstance(value, int | float) for value in spec.settings.values())
    again = worlds.make(name, 6, 3, **worlds.settings_from(name, spec.settings))
    assert again.spec == spec
    with pytest.raises(ValueError, match="observation: got 'all', expected one of standard, ext"):
        worlds.make(name, observation='all')


@BOTH
@pytest.mark.parametrize('conditions', ['nominal', 'harsh'])
def test_the_observation_holds_past_commands_and_accelerations(name: str, conditions: str) -> None:
    """As commanded after clipping, delay or not; the change of the true velocity over dt."""
    world = make(name, conditions=conditions, acceleration_scale=25.0, spawn_height=390.0)
    standard = worlds.make(name, 6, seed=3, conditions=conditions, spawn_height=390.0)
    commands = [np.tile([-1.0, 0.0, 0.0], (6, 1))] * 5
    felt = [np.zeros((6, 3))] * 2
    velocity = world.velocity.T.copy()
    seen, plain = world.observe(), standard.observe()
    for action in np.random.default_rng(1).uniform(-1.3, 1.3, (40, 6, 3)) * (1, 0.1, 0.1):
        assert np.array_equal(seen[:, :15], plain)
        assert np.allclose(seen[:, 15:30], np.concatenate(commands, axis=1), atol=1e-7)
        assert np.allclose(seen[:, 30:], np.concatenate(felt, axis=1) / 25.0, atol=1e-6)
        seen, _, terminated, *_ = world.step(action)
        plain = standard.step(action)[0]
        assert not terminated.any()
        commands = [action.clip(-1, 1), *commands[:4]]
        felt = [(world.velocity.T - velocity) / 0.02, felt[0]]
        velocity = world.velocity.T.copy()


def test_accelerations_are_clipped_like_other_observations() -> None:
    """To `observation_limit`."""
    world = make('rocket', acceleration_scale=0.1)
    seen = world.step(np.tile([-1.0, 0.0, 0.0], (6, 1)))[0]
    assert np.array_equal(seen[:, 31], np.full(6, -5.0, np.float32))


@BOTH
def test_the_next_episode_begins_without_past_commands(name: str) -> None:
    """It begins idle and at rest; the final observation still holds the past."""
    world = make(name, time_limit=0.1)
    for _ in range(6):
        seen, _, _, _, info = world.step(np.full((6, 3), 0.5))
    assert len(info['final_rows']) == 6
    assert np.array_equal(seen[:, 15:], np.tile(
        [*[-1.0, 0.0, 0.0] * 5, *[0.0] * 6], (6, 1)).astype(np.float32))
    assert (info['final_observation'][:, 15:30] == 0.5).all()
    assert info['final_observation'][:, [31, 34]].all()


def test_turned_axes_turn_accelerations_and_actions() -> None:
    """Commands and accelerations are in the axes in which a pilot observes and steers."""
    turned = make('rocket_planar', spawn_heading=180.0, spawn_height=390.0, conditions='mix')
    plain = make('rocket_planar', spawn_height=390.0, conditions='mix')
    cos, sin = turned._heading
    assert np.abs(sin).max() > 0.5
    for throttle in np.linspace(-1, 1, 30):
        in_plane = np.tile([throttle, 0.0, 0.003], (6, 1))
        across = np.stack([np.full(6, throttle), 0.003 * sin, 0.003 * cos], axis=1)
        seen, ours = turned.step(across)[0], plain.step(in_plane)[0]
        assert np.allclose(seen[:, 15:18], across, atol=1e-7)
        for first in (0, 3, 30, 33):
            along, up, over = ours[:, first:first + 3].T.astype(float)
            assert np.allclose(over, 0, atol=1e-6)
            assert np.allclose(seen[:, first:first + 3].T, [
                cos * along, up, -sin * along], atol=1e-5)
