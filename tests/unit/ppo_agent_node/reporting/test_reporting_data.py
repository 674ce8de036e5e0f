# SPDX-License-Identifier: Apache-2.0
"""Data from which pictures of several episodes or runs are drawn: bins, groups, bands."""
from __future__ import annotations

import json
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import yaml
from matplotlib.figure import Figure
from support.training.reports import flown
from support.training.reports import write_evaluation
from support.training.reports import write_training

from ppo_agent_node.commands.report import write_comparison
from ppo_agent_node.evaluation import episode_table
from ppo_agent_node.evaluation.metrics import summarise
from ppo_agent_node.reporting.pictures import learning_curves
from ppo_agent_node.reporting.pictures import style
from ppo_agent_node.reporting.pictures.initial_conditions import binned
from ppo_agent_node.reporting.pictures.initial_conditions import conditions_figure
from ppo_agent_node.reporting.pictures.initial_conditions import label
from ppo_agent_node.reporting.pictures.initial_conditions import varying
from ppo_agent_node.reporting.pictures.learning_curves import Curve
from ppo_agent_node.reporting.run_files import load


def test_bins_hold_equally_many_and_have_wilsons_interval() -> None:
    values = np.random.default_rng(0).permutation(1000) / 10.0
    landed = values < 47.0
    rates = binned(values, landed)
    assert rates.flown.tolist() == [100] * 10
    assert rates.landed.tolist() == [100] * 4 + [70] + [0] * 5
    assert rates.edges[[0, -1]].tolist() == [0.0, 99.9]
    # The closed form for 70 of 100 at z = 1.96 (Wilson, 1927).
    z, n, p = 1.959963984540054, 100, 0.7
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    assert rates.interval[4] == pytest.approx((centre - half, centre + half))
    assert rates.interval[0] == pytest.approx((1 / (1 + z * z / n), 1.0))


def test_equal_values_are_never_parted_and_few_make_one_bin() -> None:
    values = np.repeat([0.0, 1.0, 2.0], (400, 10, 90))
    rates = binned(values, values > 0)
    # The tenths end at 0 (eight times), at 0.2, between the last 0 and the first 1, and at 2.
    assert rates.flown.tolist() == [400, 100]
    assert rates.landed.tolist() == [0, 100]
    assert binned(np.arange(20.0), np.arange(20) < 5).flown.tolist() == [20]
    assert binned(np.zeros(60), np.zeros(60, np.bool_)).flown.tolist() == [60]


def test_only_conditions_that_vary_are_drawn() -> None:
    calm = episode_table.from_result(flown(pilot='random', level=1))
    assert list(varying(calm)) == ['start_tilt_deg']
    result = flown(level=8)
    table = episode_table.from_result(result)
    assert list(varying(table)) == [
        'start_descent_m_s', 'start_offset_m', 'start_drift_m_s', 'start_tilt_deg',
        'start_spin_rad_s']
    figure = conditions_figure(summarise(result), table)
    assert figure is not None
    assert [axes.get_xlabel() for axes in figure.axes] == [label(name) for name in varying(table)]
    assert label('start_descent_m_s') == 'downward speed at the start (m/s)'
    assert label('start_place') == 'place at the start'
    still = episode_table.EpisodeTable(
        {'start_height_m': np.full(60, 200.0)}, {'outcome': ('landed',) * 60})
    assert conditions_figure({}, still) is None


def test_runs_are_grouped_by_all_settings_but_the_seed(tmp_path: Path) -> None:
    # Neither does any curve depend on plots.
    runs = [load(write_training(
        tmp_path / f'{number}', seed, clip_range=clip, gamma=gamma, plots=number == 0))
            for number, (seed, clip, gamma) in enumerate((
                (1, 0.1, 0.99), (2, 0.1, 0.99), (1, 0.3, 0.99), (3, 0.3, 0.9)))]
    groups = learning_curves.groups(runs)
    assert [[run.name for run in group.runs] for group in groups] == [['0', '1'], ['2'], ['3']]
    assert [group.title for group in groups] == [
        'A: clip_range 0.1, gamma 0.99', 'B: clip_range 0.3, gamma 0.99',
        'C: clip_range 0.3, gamma 0.9']
    alone = learning_curves.groups(runs[:2])
    assert [(group.title, len(group.runs)) for group in alone] == [('rocket', 2)]


def test_a_run_from_before_a_setting_of_its_world_belongs_to_later_equal_ones(
        tmp_path: Path) -> None:
    runs = []
    for reach in (None, 0.0, 0.5):
        folder = tmp_path / str(reach)
        config = yaml.safe_load((write_training(folder) / 'config.yaml').read_text())
        config['world'] = 'lunar_lander'
        config['world_settings'] = {'gravity': 10.0} | (
            {} if reach is None else {'spawn_reach': reach})
        (folder / 'config.yaml').write_text(yaml.safe_dump(config))
        runs.append(load(folder))
    groups = learning_curves.groups(runs)
    assert [[run.name for run in group.runs] for group in groups] == [['None', '0.0'], ['0.5']]
    assert [group.title for group in groups] == [
        'A: world.spawn_reach 0.0', 'B: world.spawn_reach 0.5']


def test_evaluations_without_a_run_are_named_by_pilot_and_level(tmp_path: Path) -> None:
    runs = [
        load(write_evaluation(tmp_path / 'expert', flown(level=8))),
        load(write_evaluation(tmp_path / 'random', flown(pilot='random'))),
        load(write_training(tmp_path / 'run'))]
    titles = [group.title for group in learning_curves.groups(runs)]
    assert titles[0].startswith('A: pilot expert, level 8')
    assert titles[1].startswith('B: pilot random, level 7')
    assert titles[2].startswith('C: ')
    assert 'pilot' not in titles[2]
    assert 'not set' not in titles[0] + titles[1]


def test_the_band_is_median_lowest_and_highest_where_all_seeds_are() -> None:
    x = np.arange(11.0)
    curves = [Curve(x, 1.0 * x), Curve(x + 2, 3.0 * (x + 2)), Curve(x, 0.0 * x - 1)]
    over = learning_curves.band(curves)
    assert over is not None
    assert over.x[[0, -1]].tolist() == [2.0, 10.0]
    each = np.stack([over.x, 3 * over.x, np.full_like(over.x, -1.0)])
    assert over.median == pytest.approx(np.median(each, axis=0))
    assert over.low == pytest.approx(each.min(axis=0))
    assert over.high == pytest.approx(each.max(axis=0))
    assert learning_curves.band([Curve(x, x), Curve(x + 20, x)]) is None


def test_curves_stand_over_steps_and_over_the_clock(tmp_path: Path) -> None:
    run = load(write_training(tmp_path / 'run', seed=2, iterations=4))
    steps, clock = (
        learning_curves.curve(run, 'mean_return', by_time) for by_time in (False, True))
    assert steps is not None
    assert clock is not None
    assert steps.x.tolist() == [1100, 1200, 1300]
    assert steps.y.tolist() == clock.y.tolist() == [3.0, 4.0, 5.0]
    # Half a minute of demonstrations, as much of cloning, then one minute an iteration.
    assert clock.x.tolist() == [3.0, 4.0, 5.0]
    assert learning_curves.curve(run, 'scores') is None


def labels(figure: Figure | None) -> list[str]:
    """Return the labels in the legend of a figure."""
    assert figure is not None
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_every_group_that_is_drawn_is_named(tmp_path: Path) -> None:
    """Also one that the first picture does not show, as its runs never flew without noise."""
    one, two, young = (
        write_training(tmp_path / name, seed, gamma=gamma)
        for name, seed, gamma in (('a', 1, 0.9), ('b', 2, 0.9), ('c', 1, 0.8)))
    log = [json.loads(line) for line in (young / 'train.jsonl').read_text().splitlines()]
    (young / 'train.jsonl').write_text(''.join(json.dumps({
        name: value for name, value in line.items() if not name.startswith('selection')
    }) + '\n' for line in log))
    runs = [load(run) for run in (one, two, young)]
    figure = learning_curves.seeds_figure(learning_curves.groups(runs))
    assert labels(figure) == ['A: gamma 0.9 (2 seeds)', 'B: gamma 0.8 (1 seed)']


@pytest.mark.parametrize('number', ['9' * 400, 'Infinity', 'NaN'])
def test_a_number_that_no_float_holds_is_refused_by_name(tmp_path: Path, number: str) -> None:
    line = f'{{"stage": "finetune", "iteration": 1, "steps": 8, "seconds": {number}}}\n'
    (tmp_path / 'train.jsonl').write_text(line)
    (tmp_path / 'config.yaml').write_text('training: {seed: 1}\n')
    with pytest.raises(ValueError, match=r'train\.jsonl: seconds: got .*, expected a number'):
        assert load(tmp_path).seconds


def test_seeds_that_do_not_overlap_have_no_median(tmp_path: Path) -> None:
    runs = [load(write_training(tmp_path / name, seed, first_step=step))
            for name, seed, step in (('a', 1, 0), ('b', 2, 9000))]
    figure = learning_curves.seeds_figure(learning_curves.groups(runs))
    assert labels(figure) == ['rocket (2 seeds)']
    assert figure is not None
    by_steps = figure.axes[0].get_lines()
    assert [line.get_linewidth() for line in by_steps] == [0.8, 0.8]


def test_outcomes_have_the_colours_of_recordings() -> None:
    """In any order: a file may list them differently."""
    names = ('landed', 'too_fast', 'tipped', 'off_pad')
    assert style.outcome_colours(names) == {
        'landed': style.GREEN, 'too_fast': style.VERMILION, 'tipped': style.PURPLE,
        'off_pad': style.ORANGE}
    assert style.outcome_colours(names[::-1]) == style.outcome_colours(names)


class Links(HTMLParser):
    """The links of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.targets += [value or '' for name, value in attributes if (tag, name) == ('a', 'href')]


def test_a_comparison_has_a_line_a_run_and_leads_to_each(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(style, 'save', lambda figure, path: path.write_bytes(b'-') and path)
    first = write_evaluation(write_training(tmp_path / 'a run #1', 1), flown())
    second = write_training(tmp_path / 'two', 2, slope=3.0)
    page = write_comparison([load(first), load(second)], tmp_path / 'all' / 'of them')
    text = page.read_text()
    assert Links(text).targets == [
        './../../a%20run%20%231/report.html', './../../two/report.html']
    assert text.count('not evaluated') == 1 and '1 of 2' in text
    assert 'data:image/png' in text
    assert 'One group' in text
    nothing = write_comparison(
        [load(write_evaluation(tmp_path / name, flown())) for name in 'xy'],
        tmp_path / 'none')
    assert 'data:image/png' not in nothing.read_text()
