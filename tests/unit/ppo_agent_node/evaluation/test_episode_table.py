# SPDX-License-Identifier: Apache-2.0
"""The table of episodes on disk: its columns, reading it back, and damaged files."""
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.training.reports import flown

from ppo_agent_node.evaluation import episode_table
from ppo_agent_node.evaluation.episode_table import EpisodeTable
from ppo_agent_node.evaluation.starts import initial_conditions
from rocket_sim_node import worlds
from rocket_sim_node.worlds import start_heights
from rocket_sim_node.worlds.lunar import vehicle
from rocket_sim_node.worlds.lunar import view
from rocket_sim_node.worlds.lunar.world import LunarLanderWorld
from rocket_sim_node.worlds.rocket import spawn


def written(path: Path, world: str, pilot: str, **settings: float) -> EpisodeTable:
    """Return the table of a few episodes, as it lies on disk."""
    episode_table.write(path, episode_table.from_result(flown(world, pilot, **settings)))
    return episode_table.read(path)


@pytest.mark.parametrize(('world', 'pilot'), [
    ('rocket', 'expert'), ('rocket', 'random'), ('rocket_planar', 'random'),
    ('lunar_lander', 'expert')])
def test_a_table_can_be_read_back(tmp_path: Path, world: str, pilot: str) -> None:
    result = flown(world, pilot)
    table, path = episode_table.from_result(result), tmp_path / 'episodes.csv'
    episode_table.write(path, table)
    back = episode_table.read(path)
    assert len(back) == 60
    assert back.words == table.words
    assert back.numbers.keys() == table.numbers.keys()
    for name, values in table.numbers.items():
        assert back.numbers[name] == pytest.approx(values, rel=1e-9, nan_ok=True), name
    assert (back.named('landed') == result.landed).all()
    assert len(path.read_text().splitlines()) == 61
    assert [one.name for one in tmp_path.iterdir()] == ['episodes.csv']


def test_the_starts_of_rockets_are_those_that_were_drawn(tmp_path: Path) -> None:
    """Read back from scaled float32 observations they agree with the draw itself."""
    table = written(tmp_path / 'episodes.csv', 'rocket', 'random', level=8)
    task = worlds.make('rocket', level=8).settings
    row, episode = (table.numbers[name].astype(int) for name in ('row', 'episode'))
    drawn = spawn.draw(5, row, episode, spawn.spawn_range(task), task)
    starts = table.starts
    assert starts['start_height_m'] == pytest.approx(np.full(60, 200.0))
    assert starts['start_descent_m_s'] == pytest.approx(-drawn.velocity[1], abs=1e-5)
    assert starts['start_offset_m'] == pytest.approx(np.hypot(*drawn.position[::2]), abs=1e-4)
    assert starts['start_drift_m_s'] == pytest.approx(np.hypot(*drawn.velocity[::2]), abs=1e-5)
    assert starts['start_spin_rad_s'] == pytest.approx(
        np.linalg.norm(drawn.spin, axis=0), abs=1e-6)
    assert (starts['start_tilt_deg'] < 45.0).all()
    assert starts['start_tilt_deg'].max() > 30.0


def test_the_push_of_a_lander_is_in_metres_per_second() -> None:
    env = worlds.make('lunar_lander', num_envs=8, seed=3)
    start = initial_conditions(env.spec, env.observe(), env.spec.settings)
    assert isinstance(env, LunarLanderWorld)
    x, y = view.hull_velocity(
        env._lanes.pose[:, 0], env._lanes.velocity[:, 0], vehicle.HULL_CENTRE)
    assert start['start_velocity_x_m_s'] == pytest.approx(x, abs=1e-5)
    assert start['start_velocity_y_m_s'] == pytest.approx(y, abs=1e-5)
    assert start['start_speed_m_s'] == pytest.approx(np.hypot(x, y), abs=1e-5)


def test_the_height_of_a_lander_is_that_above_touchdown() -> None:
    env = worlds.make('lunar_lander', num_envs=8, seed=3, spawn_reach=0.5)
    start = initial_conditions(env.spec, env.observe(), env.spec.settings)
    expected = 0.5 * start_heights.reach_share(3, np.arange(8), np.zeros(8, int))
    assert start['start_height_m'] == pytest.approx(expected, abs=0.01)


def test_columns_that_a_world_does_not_have_are_empty(tmp_path: Path) -> None:
    lander = written(tmp_path / 'lander.csv', 'lunar_lander', 'expert')
    for name in ('fuel_used_kg', 'fuel_bound_kg', 'standing'):
        assert np.isnan(lander.numbers[name]).all(), name
    assert np.abs(lander.numbers['end_x_m']).max() < 1.1 * vehicle.HALF_WIDTH
    assert np.abs(lander.numbers['end_x_m']) == pytest.approx(
        lander.numbers['distance_m'], abs=1e-5)
    assert set(lander.words['after_touchdown']) == {''}
    rocket = written(tmp_path / 'rocket.csv', 'rocket', 'expert')
    assert set(rocket.words['after_touchdown']) == {'stands'}
    assert (rocket.numbers['standing'] == 1).all()
    lost = written(tmp_path / 'lost.csv', 'rocket', 'random')
    assert set(lost.words['after_touchdown']) == {''}
    assert (lost.numbers['standing'] == 0).all()


def test_another_world_gives_its_observations_by_name() -> None:
    spec = worlds.make('lunar_lander').spec
    other = type(spec)(**{**spec.__dict__, 'name': 'other', 'observation_names': ('place', 'age')})
    start = initial_conditions(other, np.array([[1.0, 2.0], [3.0, 4.0]], np.float32), {})
    assert {name: values.tolist() for name, values in start.items()} == {
        'start_place': [1.0, 3.0], 'start_age': [2.0, 4.0]}


@pytest.mark.parametrize(('damage', 'words'), [
    (lambda lines: [lines[0].replace('outcome', 'out_come'), *lines[1:]],
     "line 1: no column 'outcome'"),
    (lambda lines: [*lines[:3], lines[3].replace(',landed,', ',landed,two,', 1), *lines[4:]],
     'line 4: got 25 columns, expected 24'),
    (lambda lines: [*lines[:2], lines[2].replace(',landed,', ',landed,much', 1), *lines[3:]],
     "line 3: column 'return': got 'much"),
    (lambda lines: lines[:1], 'no episodes'),
    (lambda lines: [], "line 1: no column 'row'"),
    (lambda lines: [*lines[:-1], lines[-1][:20]], 'line 61: got'),
])
def test_damage_is_named(tmp_path: Path, damage: object, words: str) -> None:
    path = tmp_path / 'episodes.csv'
    episode_table.write(path, episode_table.from_result(flown()))
    path.write_text('\n'.join(damage(path.read_text().splitlines())))  # type: ignore[operator]
    with pytest.raises(ValueError, match=f'episodes.csv: {words}'.replace('(', r'\(')):
        episode_table.read(path)


def test_a_table_that_is_not_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / 'episodes.csv'
    path.write_bytes(b'\xff\xfe\x00')
    with pytest.raises(ValueError, match=r'episodes\.csv: damaged'):
        episode_table.read(path)
