# SPDX-License-Identifier: Apache-2.0
"""The table of conditions: its cells, files, pictures and pilots."""
from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from ppo_agent_node.commands.report import write_report
from ppo_agent_node.evaluation import conditions_files
from ppo_agent_node.evaluation.conditions_table import Cell
from ppo_agent_node.evaluation.conditions_table import fly_table
from ppo_agent_node.evaluation.metrics import summarise
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.nodes import evaluate as node
from ppo_agent_node.nodes.evaluate import EvaluationParameters
from ppo_agent_node.nodes.flights.conditions_table import fly_and_write_table
from ppo_agent_node.pilots import choice
from ppo_agent_node.pilots.expert.expert import ExpertPilot
from ppo_agent_node.pilots.random import RandomPilot
from ppo_agent_node.reporting.pictures import style
from ppo_agent_node.reporting.pictures.conditions import heat_maps
from ppo_agent_node.reporting.pictures.conditions import short_rate
from ppo_agent_node.statistics import wilson
from rocket_sim_node import worlds
from rocket_sim_node.worlds.jobs import SerialFleet
from rocket_sim_node.worlds.rocket import conditions

ROWS = {label: conditions.SINGLE[label] for label in ('nominal', 'lag 0.2 s')}
LOW = {'spawn_height': 30.0}


def made(pilots: tuple[str, ...] = ('policy', 'expert')) -> dict[str, Any]:
    """Return a table with every condition, as if 1 000 episodes had been flown for each cell."""
    cells = []
    for place, pilot in enumerate(pilots):
        for level in (7, 8):
            for number, condition in enumerate(conditions.SINGLE):
                landed = max(0, 1000 - place - number * level)
                cells.append({
                    'pilot': pilot, 'level': level, 'condition': condition, 'episodes': 1000,
                    'landed': landed, 'landing_rate': landed / 1000,
                    'landing_rate_interval': list(wilson(landed, 1000)),
                    'mean_return': 295.25 - number, 'mean_return_interval': [200.0, 296.0],
                    'mean_return_landed': None, 'return_p05': 100.0, 'tanks_dry': 0.125,
                    'fuel_ratio': 1.0625, 'hover_time': {'mean': 0.5, 'p95': 1.0},
                    'ignitions': {'mean': 1.0, 'p95': 1.0},
                    'control_effort': {'mean': 0.25, 'p95': 0.5}})
    return {
        'world': 'rocket', 'num_envs': 250, 'seed': 5, 'episodes': 1000, 'pilots': list(pilots),
        'levels': [7, 8], 'conditions': list(conditions.SINGLE), 'cells': cells}


@pytest.fixture(scope='module')
def flown() -> dict[str, Any]:
    world = worlds.make('rocket', 6, observation='extended', **LOW)
    pilots = {'expert': ExpertPilot(world.spec), 'random': RandomPilot(world.spec, 3)}
    return fly_table(world, pilots, 6, seed=9, levels=(7,), rows=ROWS)


@pytest.mark.slow
def test_a_cell_is_the_evaluation_of_its_settings(flown: dict[str, Any]) -> None:
    """The flights before it do not matter, nor does a world with fewer observations."""
    world = worlds.make('rocket', 6, **LOW)
    for pilot in (ExpertPilot(world.spec), RandomPilot(world.spec, 3)):
        for label, settings in ROWS.items():
            cell = conditions_files.cell_of(flown, pilot.name, 7, label)
            alone = summarise(evaluate(world, pilot, 6, 9, level=7, **settings))
            figures = set(cell) & set(alone)
            assert {'landing_rate', 'mean_return_interval', 'tanks_dry', 'fuel_ratio',
                    'hover_time', 'outcomes', 'failed_starts', 'return_p05'} <= figures
            assert {name: cell[name] for name in figures} == {
                name: alone[name] for name in figures}
    assert len(flown['cells']) == 4
    assert flown['settings'] == {
        'nominal': {}, 'lag 0.2 s': {'engine_lag_low': 0.2, 'engine_lag_high': 0.2}}
    nominal, late = (
        conditions_files.cell_of(flown, 'expert', 7, label) for label in flown['conditions'])
    assert nominal['mean_return'] != late['mean_return'], 'the settings must bite'
    assert json.dumps(flown, allow_nan=False)


@pytest.mark.slow
def test_progress_counts_all_cells() -> None:
    world = worlds.make('rocket_planar', 3, **LOW)
    reports: list[tuple[Cell, int, int]] = []
    fly_table(world, {'me': RandomPilot(world.spec, 1)}, 3, 1, (1, 2), ROWS,
              lambda *progress: reports.append(progress))
    assert [done for _, done, _ in reports] == sorted(done for _, done, _ in reports)
    assert reports[-1] == (Cell('me', 'lag 0.2 s', 2), 12, 12)
    assert [cell for cell, done, _ in reports if done % 3 == 0] == [
        Cell('me', label, level) for level in (1, 2) for label in ROWS]


def test_tables_that_cannot_be_flown_are_refused() -> None:
    lander, rocket = worlds.make('lunar_lander'), worlds.make('rocket')
    with pytest.raises(ValueError, match="got 'all', expected none, as world 'lunar_l"):
        fly_table(lander, {'me': RandomPilot(lander.spec)})
    with pytest.raises(ValueError, match='0 pilots, 2 levels'):
        fly_table(rocket, {})


def test_the_files_hold_every_cell(tmp_path: Path) -> None:
    table = made()
    conditions_files.write(tmp_path, table)
    assert conditions_files.read(tmp_path / 'conditions.json') == table
    assert conditions_files.read(tmp_path / 'nothing.json') is None
    lines = list(csv.DictReader(io.StringIO((tmp_path / 'conditions.csv').read_text())))
    assert len(lines) == 4 * len(conditions.SINGLE)
    assert (lines[0]['condition'], lines[0]['landing_rate'], lines[0]['mean_return_landed']) == (
        'nominal', '1', '')
    text = (tmp_path / 'conditions.md').read_text()
    assert text.count('## Level') == 2
    row = next(line for line in text.split('## Level 8')[1].splitlines() if 'mass +5 %' in line)
    assert [cell.strip() for cell in row.strip('|').split('|')] == [
        'mass +5 %', '99.20', '98.43 to 99.59', '294.25', '12.50', '99.10', '98.30 to 99.53',
        '294.25', '12.50']
    widths = {len(line) for line in text.split('## Level 7')[1].split('##')[0].splitlines()
              if line.startswith('|')}
    assert len(widths) == 1


def test_hundred_per_cent_is_never_rounded_to() -> None:
    assert [conditions_files.percent(rate) for rate in (0, 1, 0.99999, 0.00001, 0.5)] == [
        '0.00', '100.00', '99.99', '0.01', '50.00']
    assert [short_rate(rate) for rate in (0.0, 100.0, 99.99, 0.01, 50.0)] == [
        '0', '100', '> 99.9', '< 0.1', '50.0']


def without(name: str) -> dict[str, Any]:
    return {key: value for key, value in made().items() if key != name}


@pytest.mark.parametrize(('table', 'words'), [
    ([], 'expected an object'), (without('pilots'), 'pilots: got None'),
    ({**made(), 'levels': []}, r'levels: got \[\]'), (without('seed'), 'seed: got None'),
    (without('world'), 'world: got None'),
    ({**made(), 'cells': made()['cells'][1:]}, 'no cell for .*policy, level 7, nominal'),
    ({**made(), 'cells': [{**made()['cells'][0], 'mean_return': 'much'}]},
     "policy, nominal: mean_return: got 'much'"),
    ({**made(), 'cells': [{**made()['cells'][0], 'landing_rate_interval': [1]}]},
     r'landing_rate_interval: got \[1\], expected a pair')])
def test_damage_is_named(tmp_path: Path, table: object, words: str) -> None:
    path = tmp_path / 'conditions.json'
    path.write_text(json.dumps(table))
    with pytest.raises(ValueError, match=rf'conditions\.json: .*{words}'):
        conditions_files.read(path)
    path.write_text('{')
    with pytest.raises(ValueError, match=r'conditions\.json: damaged'):
        conditions_files.read(path)


@pytest.mark.parametrize('pilots', [('policy', 'expert'), ('a', 'b', 'c', 'd')])
def test_heat_maps_show_every_value(pilots: tuple[str, ...]) -> None:
    table = made(pilots)
    with style.styled():
        figure = heat_maps(table)
    panels = [axes for half in figure.subfigs for axes in half.axes if axes.images]
    assert [axes.get_title() for axes in panels] == ['level 7', 'level 8'] * 2
    for axes, level, form in (
            (panels[1], 8, lambda cell: short_rate(100 * cell['landing_rate'])),
            (panels[2], 7, lambda cell: f'{cell["mean_return"]:.1f}')):
        shown = [text.get_text() for text in axes.texts]
        assert shown == [
            form(conditions_files.cell_of(table, pilot, level, condition))
            for condition in conditions.SINGLE for pilot in pilots]
        assert [label.get_text() for label in axes.get_xticklabels()] == list(pilots)
    assert [label.get_text() for label in panels[0].get_yticklabels()] == list(conditions.SINGLE)


@pytest.mark.slow
@pytest.mark.parametrize('pilots', [
    ('policy', 'expert'), ('robust', 'default', 'expert', 'expert_estimator'),
    ('robust', 'default', 'hoverslam', 'expert', 'expert_estimator', 'random')])
def test_values_stay_within_their_cells_and_names_within_the_picture(
        pilots: tuple[str, ...]) -> None:
    table = made(pilots)
    for place, cell in enumerate(table['cells']):
        cell['mean_return'] = (-104.25, 295.25)[place % 2]
    with style.styled():
        figure = heat_maps(table)
        FigureCanvasAgg(figure).draw()
        panels = [axes for half in figure.subfigs for axes in half.axes if axes.images]
        for axes in panels:
            room = axes.get_window_extent().width / len(pilots)
            assert all(text.get_window_extent().width < room for text in axes.texts)
            names = [label.get_window_extent() for label in axes.get_xticklabels()]
            assert all(name.x1 < figure.bbox.x1 for name in names)
        assert {'-104', '295.2'} <= {text.get_text() for text in panels[-1].texts}


def test_the_report_shows_the_table(tmp_path: Path) -> None:
    conditions_files.write(tmp_path, made())
    page = write_report(tmp_path).read_text()
    assert (tmp_path / 'plots' / 'conditions.png').is_file()
    assert page.count('data:image/png') == 1
    assert 'Level 8, in numbers' in page
    assert '98.43 to 99.59' in page
    assert 'has not been evaluated' not in page


def test_the_command_flies_and_writes_the_table(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few = {'nominal': conditions.SINGLE['nominal']}
    flying = fly_and_write_table.__globals__['conditions_table'].fly_table_with
    monkeypatch.setattr(
        fly_and_write_table.__globals__['conditions_table'], 'fly_table_with',
        lambda *given, **named: flying(*given, rows=few, **named))
    world, statuses = worlds.make('rocket', 4, observation='extended', **LOW), []
    chosen = choice.choose_all(('default', 'random'), world.spec, 1)
    (tmp_path / 'report.html').touch()
    fly_and_write_table(
        SerialFleet(world), chosen, 4, 1, (1,), tmp_path, statuses.append, plots=False)
    assert not (tmp_path / 'report.html').exists(), 'it was of an earlier table'
    table = fly_and_write_table(
        SerialFleet(world), chosen, 4, 1, (1,), tmp_path, statuses.append)
    assert table['pilots'] == ['default', 'random']
    assert table['policies']['default']['policy_file'].endswith('rocket.safetensors')
    assert {path.name for path in tmp_path.iterdir()} == {
        'conditions.json', 'conditions.md', 'conditions.csv', 'plots', 'report.html'}
    assert (statuses[-1].iteration, statuses[-1].iterations, statuses[-1].level) == (8, 8, 1)


def test_pilots_are_named() -> None:
    spec = worlds.make('rocket').spec
    found = choice.choose_all(('expert', 'default', 'random', 'default'), spec)
    assert [one.label for one in found] == ['expert', 'default', 'random', 'default 2']
    assert [sorted(one.facts) for one in found[:2]] == [[], ['policy_file', 'policy_sha256']]
    with pytest.raises(FileNotFoundError, match="got 'robusst', expected a file or the name"):
        choice.choose('robusst', spec)


@pytest.mark.parametrize(('given', 'names'), [
    ({}, ['policy']), ({'pilot': 'expert'}, ['expert']),
    ({'conditions': 'all', 'optimum_sample': 0}, ['policy', 'expert']),
    ({'conditions': 'all'}, ['policy', 'expert']),
    ({'conditions': 'all', 'pilot': 'expert'}, ['expert']),
    ({'conditions': 'all', 'pilots': 'robust, default,'}, ['robust', 'default'])])
def test_the_arguments_decide_which_pilots_fly(given: dict[str, str], names: list[str]) -> None:
    options = EvaluationParameters(**given)
    node._check(options)
    assert node._names(options) == names


@pytest.mark.parametrize(('given', 'words'), [
    ({'pilots': 'expert'}, "pilots: got 'expert', expected none without conditions 'all'"),
    ({'pilot': 'random', 'pilots': 'expert', 'conditions': 'all'},
     "pilot: got 'random', expected none beside pilots, 'expert'"),
    ({'optimum_sample': 100, 'conditions': 'all'},
     "optimum_sample: got 100, expected none with conditions 'all'"),
    ({'policy': 'a', 'pilot': 'expert'}, "policy: got 'a', expected none with pilot 'expert'"),
    ({'policy': 'a', 'pilots': 'expert', 'conditions': 'all'}, 'is not among pilots')])
def test_arguments_that_contradict_are_refused(given: dict[str, str], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        node._check(EvaluationParameters(**given))
