# SPDX-License-Identifier: Apache-2.0
"""The optimum in an evaluation: figures, columns, picture, and the reason if there is none."""
from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from support.training.reports import flown

from ppo_agent_node.commands.report import write_report
from ppo_agent_node.evaluation import episode_table
from ppo_agent_node.evaluation.metrics import summarise
from ppo_agent_node.evaluation.metrics import table
from ppo_agent_node.evaluation.metrics import write_json
from ppo_agent_node.evaluation.optimum.optimiser import LandingOptimiser
from ppo_agent_node.evaluation.optimum_sample import OptimumSample
from ppo_agent_node.evaluation.optimum_sample import return_ceiling
from ppo_agent_node.evaluation.optimum_sample import solve_sample
from ppo_agent_node.evaluation.optimum_sample import starts
from ppo_agent_node.evaluation.runner import EvaluationResult
from ppo_agent_node.reporting.pictures import style
from ppo_agent_node.reporting.pictures.optimum import optimum_figure
from rocket_sim_node import worlds
from rocket_sim_node.worlds.rocket import conditions

SIZE = 4


@pytest.fixture(scope='module')
def result() -> EvaluationResult:
    """Return an evaluation of the expert on level 7."""
    return flown(level=7)


@pytest.fixture(scope='module')
def sample(result: EvaluationResult) -> OptimumSample:
    """Return the optimum of its first episodes."""
    return solve_sample(result, SIZE)


def test_starts_are_where_the_world_put_them(result: EvaluationResult) -> None:
    world = worlds.make('rocket', len(result.episodes))
    world.reset(result.seed, level=7)
    position, velocity = starts(result, SIZE)
    assert position == pytest.approx(world.position[:, :SIZE].T, abs=1e-5)
    assert velocity == pytest.approx(world.velocity[:, :SIZE].T, abs=1e-5)


def test_no_landing_beats_the_optimum_of_its_start(
        result: EvaluationResult, sample: OptimumSample) -> None:
    e = result.episodes
    assert result.landed.all()
    assert (e.fuel_used[:SIZE] > sample.fuel).all()
    assert (e.length[:SIZE] > sample.steps).all()
    assert (e.episode_return[:SIZE] < sample.ceiling).all()
    assert (sample.fuel > result.fuel_bound[:SIZE]).all()


def test_the_optimum_is_that_of_each_start_height() -> None:
    low = flown(level=1, episodes=4, spawn_reach=60.0)
    found = solve_sample(low, 4)
    assert low.landed.all()
    assert (low.episodes.fuel_used > found.fuel).all()
    assert (low.episodes.length > found.steps).all()


def test_the_figures_are_means_over_the_sample(
        result: EvaluationResult, sample: OptimumSample) -> None:
    figures = sample.figures(result)
    assert figures == {
        'fuel_optimum_kg': pytest.approx(sample.fuel.mean()),
        'time_optimum_s': pytest.approx(0.02 * sample.steps.mean()),
        'return_ceiling': pytest.approx(300 - 0.01 * sample.steps.mean()),
        'fuel_ratio_optimum': pytest.approx(
            (result.episodes.fuel_used[:SIZE] / sample.fuel).mean()),
        'optimum_sample': SIZE, 'optimum_reason': None}
    summary = summarise(result, **figures)
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    text = table(summary)
    assert f'fuel / optimum     {figures["fuel_ratio_optimum"]:.4f}' in text
    assert f'ceiling of return  {figures["return_ceiling"]:.2f}' in text
    assert 'straight drop' not in text
    assert 'fuel / straight drop' in table(summarise(result))


def test_only_landings_have_a_ratio(result: EvaluationResult, sample: OptimumSample) -> None:
    outcome = result.episodes.outcome.copy()
    outcome[:2] = result.spec.outcomes.index('tipped')
    crashed = dataclasses.replace(
        result, episodes=dataclasses.replace(result.episodes, outcome=outcome))
    figures = sample.figures(crashed)
    assert figures['optimum_sample'] == SIZE
    assert figures['fuel_ratio_optimum'] == pytest.approx(
        (result.episodes.fuel_used[2:SIZE] / sample.fuel[2:]).mean())


def test_table_page_and_picture_show_the_optimum(
        result: EvaluationResult, sample: OptimumSample, tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    # Other pictures are tested elsewhere, and turning them into pixels takes its time.
    monkeypatch.setattr(style, 'save', lambda figure, path: path.write_bytes(b'-') and path)
    episodes = episode_table.from_result(result, sample)
    episode_table.write(tmp_path / 'episodes.csv', episodes)
    read = episode_table.read(tmp_path / 'episodes.csv')
    for name, values in zip(episode_table.OPTIMUM, (sample.fuel, sample.steps), strict=True):
        assert read.numbers[name][:SIZE] == pytest.approx(values)
        assert np.isnan(read.numbers[name][SIZE:]).all()
    figures = sample.figures(result)
    write_json(tmp_path / 'evaluation.json', summarise(result, **figures))
    page = write_report(tmp_path).read_text()
    assert (tmp_path / 'plots' / 'optimum.png').exists()
    assert 'fuel used / optimum, mean' in page
    assert f'{figures["return_ceiling"]:.2f}' in page
    # Without it the next evaluation shows the straight drop again.
    episode_table.write(tmp_path / 'episodes.csv', episode_table.from_result(result))
    write_json(tmp_path / 'evaluation.json', summarise(result))
    assert 'minimum for a straight drop' in write_report(tmp_path).read_text()
    assert not (tmp_path / 'plots' / 'optimum.png').exists()


def test_the_picture_has_a_bar_for_each_landing(
        result: EvaluationResult, sample: OptimumSample) -> None:
    figures = summarise(result, **sample.figures(result))
    assert optimum_figure(figures, episode_table.from_result(result)) is None
    figure = optimum_figure(figures, episode_table.from_result(result, sample))
    assert figure is not None
    fuel, time = ([bar.get_height() for bar in axes.patches] for axes in figure.axes)
    assert fuel == pytest.approx(np.sort(
        100 * (result.episodes.fuel_used[:SIZE] / sample.fuel - 1)))
    assert time == pytest.approx(np.sort(
        100 * (result.episodes.length[:SIZE] / sample.steps - 1)))


def test_a_flight_in_a_plane_ends_when_it_has_stood_still() -> None:
    """Its start is one of `rocket`; to the landing come 0.5 s of rest, 25 steps."""
    planar = flown('rocket_planar', episodes=10, level=5)
    sample = solve_sample(planar, 2)
    optimiser = LandingOptimiser(planar.settings)
    for row, (position, velocity) in enumerate(zip(*starts(planar, 2), strict=True)):
        assert position[2] == velocity[2] == 0.0
        optimum = optimiser.solve(position, velocity)
        assert optimum is not None
        assert sample.fuel[row] == pytest.approx(optimum.least_fuel.fuel, abs=1e-3)
        assert sample.steps[row] == optimum.least_time.steps + 25
    assert (planar.episodes.length[:2] > sample.steps).all()
    assert (planar.episodes.fuel_used[:2] > sample.fuel).all()


def test_the_ceiling_is_that_of_a_perfect_landing() -> None:
    settings = worlds.make('rocket').spec.settings
    assert return_ceiling(settings, np.array([435.0, np.nan])) == pytest.approx(
        [295.65, np.nan], nan_ok=True)
    # Where steps pay, the fastest landing is not the best.
    assert np.isnan(return_ceiling({**settings, 'reward_step': 0.01}, np.array([435.0]))).all()


def none_because(sample: OptimumSample, result: EvaluationResult) -> str:
    """Return the reason of a sample without an optimum."""
    figures = sample.figures(result)
    reason = figures.pop('optimum_reason')
    assert figures.pop('optimum_sample') == 0
    assert set(figures.values()) == {None}
    assert isinstance(reason, str)
    return reason


def test_a_sample_without_an_optimum_gives_the_reason(
        result: EvaluationResult, monkeypatch: pytest.MonkeyPatch) -> None:
    assert none_because(solve_sample(result, 0), result) == 'not asked for'
    lander = flown('lunar_lander')
    assert none_because(solve_sample(lander), lander) == 'world lunar_lander burns no fuel'
    empty = dataclasses.replace(result, reset_settings={'fuel': 0.0})
    assert none_because(solve_sample(empty), empty).startswith('fuel: got 0.0')
    weak = dataclasses.replace(result, reset_settings={'max_thrust': 200_000.0})
    assert 'no start of the sample' in none_because(solve_sample(weak, 1), weak)
    monkeypatch.setitem(sys.modules, 'clarabel', None)
    reason = none_because(solve_sample(result), result)
    assert 'the library clarabel is missing: pip install clarabel==' in reason
    assert reason in table(summarise(result, **solve_sample(result).figures(result)))


def test_a_clipped_first_observation_has_no_optimum(result: EvaluationResult) -> None:
    first = result.first_observation.copy()
    first[0, result.spec.observation_names.index('velocity_x')] = (
        result.settings['observation_limit'])
    clipped = solve_sample(dataclasses.replace(result, first_observation=first), 2)
    assert np.isnan([clipped.fuel[0], clipped.steps[0], clipped.ceiling[0]]).all()
    assert clipped.fuel[1] > 700
    assert clipped.figures(result)['optimum_sample'] == 1


def test_conditions_that_are_not_nominal_have_no_optimum(result: EvaluationResult) -> None:
    for values, name in (
            (conditions.flatten({'side_acceleration': 0.5}), 'custom'),
            (conditions.settings('mix'), 'mix'), (conditions.settings('hoverslam'), 'hoverslam')):
        other = dataclasses.replace(result, reset_settings=values)
        assert none_because(solve_sample(other), other) == (
            f'conditions: got {name}, expected nominal')
