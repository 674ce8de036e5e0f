# SPDX-License-Identifier: Apache-2.0
"""The evaluation: which episodes count, what is written, and equal results each time."""
from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ppo_agent_node.evaluation import episode_table
from ppo_agent_node.evaluation import metrics
from ppo_agent_node.evaluation.metrics import summarise
from ppo_agent_node.evaluation.metrics import table
from ppo_agent_node.evaluation.metrics import write_json
from ppo_agent_node.evaluation.runner import EvaluationResult
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.evaluation.runner import quotas
from ppo_agent_node.evaluation.starts import initial_conditions
from ppo_agent_node.nodes.flights.evaluation import fly_and_write
from ppo_agent_node.pilots.expert.expert import ExpertPilot
from ppo_agent_node.pilots.random import RandomPilot
from ppo_agent_node.statistics import wilson
from rocket_sim_node import worlds
from rocket_sim_node.worlds.base import Episodes
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.jobs import SerialFleet


class CoinWorld:
    """Half of all episodes crash after 10 steps, the other half land after 100. Discrete."""

    def __init__(self, num_envs: int) -> None:
        self.spec = WorldSpec(
            name='coin', num_envs=num_envs, dt=0.02, observation_names=('age',),
            action_names=('nothing',), continuous=False, action_low=(), action_high=(),
            action_idle=(0.0,), action_count=2, outcomes=('landed', 'crashed'), settings={})

    def _lands(self, row: np.ndarray, episode: np.ndarray) -> np.ndarray:
        words = np.stack((row, episode))
        return np.array([
            np.random.default_rng((self._seed, *word)).random() < 0.5 for word in words.T], bool)

    def reset(self, seed: int | None = None, **settings: float) -> np.ndarray:
        assert not settings
        self._seed = int(seed or 0)
        self.rows = np.arange(self.spec.num_envs)
        self.episode = np.zeros_like(self.rows)
        self.age = np.zeros_like(self.rows)
        self.lands = self._lands(self.rows, self.episode)
        return self.age[:, None].astype(np.float32)

    def step(self, action: np.ndarray) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        assert action.dtype.kind == 'i'
        assert action.shape == self.rows.shape
        self.age += 1
        done = np.flatnonzero(self.age == np.where(self.lands, 100, 10))
        landed, zeros = self.lands[done], np.zeros(len(done))
        info = {
            'final_rows': done, 'final_observation': self.age[done, None].astype(np.float32),
            'episodes': Episodes(
                done, self.episode[done], np.where(landed, 100.0, -100.0), self.age[done],
                np.where(landed, 0, 1).astype(np.uint8), zeros, zeros, zeros, zeros, zeros,
                zeros, np.zeros(len(done), np.int64), zeros),
        }
        self.episode[done] += 1
        self.age[done] = 0
        self.lands[done] = self._lands(done, self.episode[done])
        none = np.zeros(self.spec.num_envs)
        return self.age[:, None].astype(np.float32), none, none > 0, none > 0, info

    def snapshot(self) -> bytes:
        raise NotImplementedError

    def restore(self, state: bytes) -> np.ndarray:
        raise NotImplementedError


def _first_come(env: CoinWorld, episodes: int, seed: int) -> int:
    """Count landings the naive way: the first episodes that end."""
    env.reset(seed)
    ended: list[Episodes] = []
    while sum(map(len, ended)) < episodes:
        ended.append(env.step(np.zeros(env.spec.num_envs, np.int64))[4]['episodes'])
    return int((Episodes.concatenate(ended).outcome[:episodes] == 0).sum())


def test_short_episodes_do_not_bias_but_first_come_counting_would() -> None:
    env = CoinWorld(250)
    naive = wilson(_first_come(env, 250, seed=1), 250)
    fair = wilson(int(evaluate(env, RandomPilot(env.spec), 250, seed=1).landed.sum()), 250)
    assert naive[1] < 0.3, 'the construct must bite'
    assert fair[0] < 0.5 < fair[1]


@pytest.mark.parametrize(('episodes', 'num_envs', 'share'), [
    (10, 4, [3, 3, 2, 2]), (8, 4, [2, 2, 2, 2]), (2, 4, [1, 1, 0, 0])])
def test_each_row_flies_its_quota(episodes: int, num_envs: int, share: list[int]) -> None:
    assert quotas(episodes, num_envs).tolist() == share
    env = CoinWorld(num_envs)
    result = evaluate(env, RandomPilot(env.spec), episodes, seed=3)
    assert np.bincount(result.episodes.row, minlength=num_envs).tolist() == share
    # And it is the first ones, in order: an episode that is skipped would be a choice.
    expected = [(row, k) for row, count in enumerate(share) for k in range(count)]
    rows, numbers = result.episodes.row.tolist(), result.episodes.episode.tolist()
    assert list(zip(rows, numbers, strict=True)) == expected


def test_less_than_one_episode_is_refused() -> None:
    env = CoinWorld(2)
    with pytest.raises(ValueError, match='episodes, num_envs: got 0 and 2'):
        evaluate(env, RandomPilot(env.spec), 0)


def _expert(seed: int, num_envs: int = 40, **settings: float) -> EvaluationResult:
    env = worlds.make('rocket', num_envs, seed=99)
    return evaluate(env, ExpertPilot(env.spec), 60, seed, **settings)


def _same(left: EvaluationResult, right: EvaluationResult) -> bool:
    """Compare every number of two results, bit for bit."""
    def numbers(result: EvaluationResult) -> list[bytes]:
        arrays = [getattr(result.episodes, f.name) for f in dataclasses.fields(Episodes)]
        arrays += [result.fuel_bound, result.end_position,
                   result.first_observation, result.final_observation]
        return [array.tobytes() for array in arrays]

    return numbers(left) == numbers(right)


@pytest.mark.slow
def test_equal_seeds_give_equal_results_and_others_differ() -> None:
    result = _expert(5, level=8)
    assert _same(result, _expert(5, level=8))
    assert not _same(result, _expert(6, level=8))


def test_each_evaluation_starts_with_the_pilot_as_given() -> None:
    """Otherwise an evaluation that starts again after a restart would differ."""
    env = worlds.make('rocket', 10)
    pilot = RandomPilot(env.spec, 3)
    assert _same(evaluate(env, pilot, 20, 1), evaluate(env, pilot, 20, 1))


@pytest.mark.slow
def test_an_episode_depends_only_on_its_row_and_number() -> None:
    # The streams of a world are counter-based: more rockets must not change those there were.
    few, many = _expert(5, num_envs=30, level=7), _expert(5, num_envs=60, level=7)
    first = few.episodes.episode == 0
    assert few.episodes.episode_return[first].tolist() == (
        many.episodes.episode_return[:30].tolist())


@pytest.mark.slow
def test_the_bound_uses_the_first_velocity_of_each_episode() -> None:
    result = _expert(5, level=8)
    velocity = result.first_observation[:, 4] * result.settings['velocity_scale']
    assert len(set(velocity.tolist())) == 60
    assert (velocity <= 0).all()
    assert (velocity >= -30.0001).all()
    order = np.argsort(-velocity)
    assert (np.diff(result.fuel_bound[order]) >= 0).all()
    assert np.hypot(*result.end_position.T) == pytest.approx(
        result.episodes.distance, abs=1e-4)
    env = worlds.make('rocket', 10)
    low = evaluate(env, ExpertPilot(env.spec), 10, 1, level=1, spawn_height=100.0)
    assert (low.fuel_bound < 600).all()


def test_episodes_that_begin_at_different_heights_have_no_straight_drop_bound() -> None:
    result = evaluate(
        world := worlds.make('rocket', 8, level=1), ExpertPilot(world.spec), 8, 3,
        spawn_reach=40.0)
    assert np.isnan(result.fuel_bound).all()
    heights = initial_conditions(
        result.spec, result.first_observation, result.settings)['start_height_m']
    world.reset(3, spawn_reach=40.0)
    assert heights == pytest.approx(world.position[1], rel=1e-5)
    assert len(set(heights)) == 8
    assert summarise(result)['fuel_ratio'] is None


def test_the_summary_describes_the_evaluation_and_is_json() -> None:
    result = _expert(5, level=7)
    summary = summarise(result, policy_hash='abc')
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    e = result.episodes
    assert summary['world'] == 'rocket'
    assert summary['world_settings']['landed_distance'] == 15.0
    assert summary['world_settings']['level'] == 7
    assert (summary['level'], summary['seed'], summary['episodes']) == (7, 5, 60)
    assert (summary['policy'], summary['policy_hash']) == ('expert', 'abc')
    assert summary['landed'] == summary['outcomes']['landed'] == 60
    assert list(summary['outcomes']) == list(result.spec.outcomes)
    assert sum(summary['outcomes'].values()) == 60
    assert summary['landing_rate_interval'] == list(wilson(60, 60))
    low, high = summary['mean_return_interval']
    assert low < summary['mean_return'] < high
    assert summary['mean_return'] == pytest.approx(e.episode_return.mean())
    for name, values in (('touchdown_speed', e.touchdown_speed), ('tilt', np.rad2deg(e.tilt)),
                         ('distance', e.distance), ('fuel_used_kg', e.fuel_used)):
        assert summary[name] == {
            'mean': pytest.approx(values.mean()), 'p95': pytest.approx(np.quantile(values, 0.95))}
    assert summary['fuel_ratio'] == pytest.approx((e.fuel_used / result.fuel_bound).mean())
    assert 1.0 < summary['fuel_ratio'] < 1.2
    text = table(summary)
    assert '100.00 %' in text
    assert 'landed 60' in text
    with pytest.raises(ValueError, match='seed'):
        summarise(result, seed=3)


def test_a_pilot_that_never_lands_leaves_nulls_and_no_nan(tmp_path: Path) -> None:
    env = worlds.make('rocket', 20)
    result = evaluate(env, RandomPilot(env.spec, 3), 30, 3, level=8)
    summary = summarise(result)
    assert summary['landed'] == 0
    assert summary['outcomes']['tilt_limit'] == 30
    assert summary['fuel_ratio'] is None
    assert summary['touchdown_speed'] == {'mean': None, 'p95': None}
    write_json(tmp_path / 'evaluation.json', summary)
    assert 'NaN' not in (tmp_path / 'evaluation.json').read_text()
    assert 'tilt_limit 30' in table(summary)


def test_a_world_without_fuel_has_no_fuel_figures() -> None:
    env = CoinWorld(10)
    result = evaluate(env, RandomPilot(env.spec), 30, 3)
    summary = summarise(result)
    assert summary['level'] is None
    assert summary['fuel_used_kg'] == {'mean': None, 'p95': None}
    assert summary['fuel_bound_kg'] is summary['fuel_ratio'] is None
    assert json.dumps(summary, allow_nan=False)
    assert 'fuel' not in table(summary)


def test_the_lunar_lander_is_evaluated(tmp_path: Path) -> None:
    """Time-outs are truncations there; nothing is burnt, and there are no levels."""
    env = worlds.make('lunar_lander', 6, time_limit=1.5)
    result = evaluate(env, RandomPilot(env.spec, 1), 24, 1)
    summary = summarise(result)
    assert summary['level'] is None
    assert summary['outcomes']['crashed'] > 0 < summary['outcomes']['timeout']
    assert sum(summary['outcomes'].values()) == 24
    assert summary['fuel_used_kg'] == {'mean': None, 'p95': None}
    assert summary['touchdown_speed']['mean'] > 0
    write_json(tmp_path / 'evaluation.json', summary)
    assert 'lunar_lander\n' in table(summary)


@pytest.mark.slow
def test_the_files_of_a_node_and_level_0_which_is_that_of_the_world(tmp_path: Path) -> None:
    env, statuses = worlds.make('rocket', 4, spawn_height=20.0), []
    pilot = RandomPilot(env.spec, 1)
    summary = fly_and_write(SerialFleet(env), pilot, 8, 1, 0, tmp_path, statuses.append)
    assert summary['level'] == 7
    assert json.loads((tmp_path / 'evaluation.json').read_text())['level'] == 7
    assert len(episode_table.read(tmp_path / 'episodes.csv')) == 8
    assert (tmp_path / 'plots' / 'outcomes.png').is_file()
    assert 'data:image/png' in (tmp_path / 'report.html').read_text()
    assert {status.level for status in statuses} == {7}
    asked = fly_and_write(
        SerialFleet(env), RandomPilot(env.spec, 1), 8, 1, 7, None, statuses.append)
    assert {**asked, 'reset_settings': {}} == summary
    (tmp_path / 'plots' / 'training.png').touch()
    again = fly_and_write(
        SerialFleet(env), pilot, 8, 2, 0, tmp_path, statuses.append, plots=False)
    assert again['seed'] == 2
    # Pictures of the earlier episodes would be false.
    assert [path.name for path in (tmp_path / 'plots').iterdir()] == ['training.png']
    assert not (tmp_path / 'report.html').exists()
    # Those of the training would be false as well after more of it, also a page without pictures.
    for names in (('plots/training.png', 'report.html'), ('report.html',)):
        for name in names:
            (tmp_path / name).touch()
        fly_and_write(
            SerialFleet(env), pilot, 8, 2, 0, tmp_path, statuses.append, plots=False,
            sections=('Evaluation', 'Training'))
        assert not any((tmp_path / name).exists() for name in names)
        shutil.rmtree(tmp_path / 'plots', ignore_errors=True)


def test_pictures_of_earlier_figures_are_gone_before_new_figures_are_written(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    env = worlds.make('rocket', 4, spawn_height=20.0)
    (tmp_path / 'plots').mkdir()
    (tmp_path / 'plots' / 'outcomes.png').touch()

    def full(path: Path, content: object) -> None:
        raise OSError('the disk is full')

    monkeypatch.setattr(metrics, 'write_json', full)
    with pytest.raises(OSError, match='the disk is full'):
        fly_and_write(
            SerialFleet(env), RandomPilot(env.spec, 1), 4, 1, 0, tmp_path, [].append,
            optimum_sample=0)
    assert not list((tmp_path / 'plots').iterdir())


def test_writing_replaces_the_file_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / 'runs' / 'evaluation.json'
    write_json(path, {'landed': 1})
    with pytest.raises(ValueError, match='JSON'):
        write_json(path, {'landed': float('nan')})
    assert json.loads(path.read_text()) == {'landed': 1}
    write_json(path, {'landed': 2})
    assert json.loads(path.read_text()) == {'landed': 2}
    assert [entry.name for entry in path.parent.iterdir()] == ['evaluation.json']


def test_progress_counts_up_to_the_end() -> None:
    env = CoinWorld(4)
    reports: list[tuple[int, int]] = []
    evaluate(env, RandomPilot(env.spec), 10, 1, lambda done, total: reports.append((done, total)))
    assert reports[-1] == (10, 10)
    assert [done for done, _ in reports] == sorted({done for done, _ in reports})


def test_random_pilots_fill_the_action_space() -> None:
    spec = worlds.make('rocket').spec
    actions = RandomPilot(spec, 1)(np.zeros((5000, 15), np.float32))
    assert (actions.shape, actions.dtype) == ((5000, 3), np.float32)
    assert np.abs(actions).max() <= 1
    assert actions.mean(axis=0) == pytest.approx([0, 0, 0], abs=0.03)
    assert actions.std(axis=0) == pytest.approx([3**-0.5] * 3, abs=0.02)
    assert (RandomPilot(spec, 1)(np.zeros((5000, 15), np.float32)) == actions).all()
    assert (RandomPilot(spec, 2)(np.zeros((5000, 15), np.float32)) != actions).any()
    discrete = RandomPilot(CoinWorld(1).spec, 1)(np.zeros((1000, 1), np.float32))
    assert discrete.dtype == np.int64
    assert set(discrete.tolist()) == {0, 1}
