# SPDX-License-Identifier: Apache-2.0
"""Reports: the data of their pictures, the contents of their pages, and refusals."""
from __future__ import annotations

import base64
import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import yaml
from matplotlib.image import imread
from support.training.reports import flown
from support.training.reports import write_evaluation
from support.training.reports import write_training

from ppo_agent_node.commands import report
from ppo_agent_node.evaluation.episode_table import EpisodeTable
from ppo_agent_node.evaluation.episode_table import from_result
from ppo_agent_node.evaluation.metrics import summarise
from ppo_agent_node.reporting.pages import figures_table
from ppo_agent_node.reporting.pages import settings_table
from ppo_agent_node.reporting.pictures import catalogue
from ppo_agent_node.reporting.pictures import style
from ppo_agent_node.reporting.pictures.flights import outcomes_figure
from ppo_agent_node.reporting.pictures.flights import returns_figure
from ppo_agent_node.reporting.pictures.touchdowns import fuel_figure
from ppo_agent_node.reporting.pictures.training_curves import smooth
from ppo_agent_node.reporting.pictures.training_curves import training_figure
from ppo_agent_node.reporting.run_files import load
from ppo_agent_node.statistics import bootstrap_mean
from ppo_agent_node.statistics import mean_interval

OF_ROCKET = {
    'outcomes.png', 'returns.png', 'touchdown.png', 'footprint.png', 'fuel.png',
    'initial_conditions.png'}
OF_TRAINING = {'cloning.png', 'training.png', 'diagnostics.png'}


class Page(HTMLParser):
    """Contents of a page: text, tags, pictures and links; and whether all tags are closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.text, self.tags, self.pictures, self.links = '', [], [], []
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert not self._open, f'not closed: {self._open}'

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        given = dict(attributes)
        if tag == 'img':
            self.pictures.append(given['src'])
        if tag == 'a':
            self.links.append(given['href'])
        if tag not in ('img', 'meta', 'input'):
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self._open and self._open[-1] not in ('style', 'script'):
            self.text += data


@pytest.fixture(scope='module')
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a training run with its evaluation, reported."""
    folder = tmp_path_factory.mktemp('runs') / '<script>alert(1)</script> & co'.replace('/', '∕')
    write_training(folder, seed=4, clip_range=0.25)
    write_evaluation(folder, flown())
    assert report.write_report(folder) == folder / 'report.html'
    return folder


@pytest.fixture
def unpainted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make figures without turning them into pixels, which is what takes its time."""
    monkeypatch.setattr(style, 'save', lambda figure, path: path.write_bytes(b'-') and path)


@pytest.mark.slow
def test_all_pictures_exist_and_are_not_blank(run: Path) -> None:
    paths = list((run / 'plots').iterdir())
    assert {path.name for path in paths} == OF_ROCKET | OF_TRAINING
    for path in paths:
        image = imread(path)[..., :3]
        assert min(image.shape[:2]) > 400
        ink = (image < 0.9).any(axis=-1).mean()
        assert 0.01 < ink < 0.6, f'{path.name} is blank or black'


def test_the_page_is_one_file_with_every_picture_and_every_setting(run: Path) -> None:
    text = (run / 'report.html').read_text()
    page = Page(text)
    embedded = {base64.b64decode(one.removeprefix('data:image/png;base64,'))
                for one in page.pictures}
    assert embedded == {path.read_bytes() for path in (run / 'plots').iterdir()}
    assert not re.search(r'(src|href)="(https?:)?//', text)
    config = yaml.safe_load((run / 'config.yaml').read_text())
    for name in (*config['training'], *config['world_settings'], 'version'):
        assert name in page.text, name
    for words in ('60 of 60, 100.00 %', '93.98 to 100.00 %', 'level 7', 'training seed4',
                  'time7 min 0 s'):
        assert words in page.text, words
    assert f'default): {len(config["training"])} settings, 2 changed' in page.text
    links = {link.removeprefix('./') for link in page.links}
    assert {'config.yaml', 'train.jsonl', 'evaluation.json', 'episodes.csv', 'plots',
            'report.html'} <= links


def test_names_from_files_are_shown_letter_by_letter(run: Path) -> None:
    text = (run / 'report.html').read_text()
    page = Page(text)
    assert run.name in page.text
    assert '<script>alert' not in text
    assert page.tags.count('script') == 1


def test_the_settings_that_differ_from_the_preset_are_marked(run: Path) -> None:
    sections = settings_table.sections(load(run))
    assert [section.title for section in sections] == [
        'Run', 'Training (preset default)', 'World']
    changed = {one.name: (one.value, one.usual) for one in sections[1].settings if one.differs}
    assert changed == {'clip_range': ('0.25', '0.2'), 'seed': ('4', '1')}
    assert not any(one.differs for one in sections[2].settings)
    meaning = {one.name: one.meaning for section in sections for one in section.settings}
    assert meaning['target_kl'].endswith(', nats')
    assert meaning['dry_mass']


def test_the_original_preset_is_recognised(tmp_path: Path) -> None:
    run = load(write_training(tmp_path / 'run'))
    values = settings_table.presets.load_preset('original', 'rocket', gamma=0.5).flat()
    name, preset = settings_table.nearest_preset(run.world, values)
    assert name == 'original'
    assert preset['gamma'] != 0.5


@pytest.mark.usefixtures('unpainted')
def test_an_evaluation_alone_has_its_report(tmp_path: Path) -> None:
    folder = write_evaluation(tmp_path / 'figures', flown('lunar_lander'))
    page = Page(report.write_report(folder).read_text())
    assert {path.name for path in (folder / 'plots').iterdir()} == (
        OF_ROCKET - {'fuel.png'})
    assert 'lunar_lander' in page.text
    assert 'Training' not in page.text
    assert 'enable_wind' in page.text or 'gravity' in page.text
    assert not (tmp_path / 'figures' / 'config.yaml').exists()


@pytest.mark.usefixtures('unpainted')
def test_a_report_without_landings_removes_touchdown_pictures(tmp_path: Path) -> None:
    folder = write_evaluation(tmp_path / 'figures', flown())
    report.write_report(folder)
    write_evaluation(folder, flown(pilot='random'))
    report.write_report(folder)
    assert {path.name for path in (folder / 'plots').iterdir()} == {
        'outcomes.png', 'returns.png', 'fuel.png', 'initial_conditions.png'}


@pytest.mark.usefixtures('unpainted')
def test_the_report_of_an_unfinished_run_has_learning_curves(tmp_path: Path) -> None:
    folder = write_training(tmp_path / 'run', scores=True)
    page = Page(report.write_report(folder).read_text())
    assert {path.name for path in (folder / 'plots').iterdir()} == OF_TRAINING | {'score.png'}
    assert 'has not been evaluated yet' in page.text
    begun = write_training(tmp_path / 'begun', iterations=0)
    report.write_report(begun)
    assert {path.name for path in (begun / 'plots').iterdir()} == {'cloning.png'}
    (begun / 'train.jsonl').unlink()
    assert 'No iterations' in Page(report.write_report(begun).read_text()).text


@pytest.mark.usefixtures('unpainted')
def test_the_report_of_an_older_run_names_the_missing_episodes(tmp_path: Path) -> None:
    folder = write_evaluation(tmp_path / 'run', flown())
    (folder / 'episodes.csv').unlink()
    figures = json.loads((folder / 'evaluation.json').read_text())
    del figures['world_settings'], figures['standing_rate']
    (folder / 'evaluation.json').write_text(json.dumps(figures))
    page = Page(report.write_report(folder).read_text())
    assert 'No episodes.csv' in page.text
    assert 'touchdown speed, mean' in page.text
    assert [path.name for path in (folder / 'plots').iterdir()] == ['outcomes.png']


def test_the_pie_has_the_shares_and_the_bars_the_counts() -> None:
    figures = {
        'world': 'rocket', 'level': 7, 'episodes': 200, 'landed': 150, 'landing_rate': 0.75,
        'landing_rate_interval': [0.68, 0.8], 'outcomes': {
            'landed': 150, 'too_fast': 48, 'tipped': 2, 'timeout': 0}}
    figure = outcomes_figure(figures)
    pie, bars = figure.axes
    angles = [(wedge.theta2 - wedge.theta1) % 360 for wedge in pie.patches]
    assert angles == pytest.approx([270.0, 86.4, 3.6], abs=1e-3)
    assert [text.get_text() for text in pie.texts] == ['landed\n75 %', 'too fast\n24 %', '']
    assert [bar.get_width() for bar in bars.patches] == pytest.approx([75, 24, 1, 0])
    assert [text.get_text() for text in bars.texts] == [
        '150 (75.00 %)', '48 (24.00 %)', '2 (1.00 %)', '0']
    alone = outcomes_figure({**figures, 'outcomes': {'landed': 0, 'timeout': 200}}).axes[0]
    assert [text.get_text() for text in alone.texts if text.get_text()] == ['timeout\n100 %']


def test_smoothing_skips_missing_values() -> None:
    values = np.array([np.nan, 1.0, np.nan, 2.0])
    assert smooth(values) == pytest.approx([np.nan, 1.0, 1.0, 1.2], nan_ok=True)


def test_learning_curves_show_the_logs_numbers(tmp_path: Path) -> None:
    lines = load(write_training(tmp_path / 'run', seed=3)).stage('finetune')
    returns, landing, level = training_figure(lines).axes
    raw, smoothed, alone = (line.get_ydata() for line in returns.lines)
    assert raw == pytest.approx([np.nan, 4, 5, 6, 7, 8], nan_ok=True)
    assert smoothed == pytest.approx(smooth(raw), nan_ok=True)
    assert alone == pytest.approx([30, 32, 34])
    assert landing.lines[0].get_ydata()[1:] == pytest.approx(np.full(5, 50.0))
    assert level.lines[0].get_ydata() == pytest.approx([1, 1, 2, 2, 3, 3])
    for axes in (returns, landing, level):
        assert axes.get_ylabel()
    assert len(training_figure([{**line, 'level': 7} for line in lines]).axes) == 2


def test_a_reverse_curriculum_has_a_curve_of_its_heights(tmp_path: Path) -> None:
    lines = load(write_training(tmp_path / 'run', seed=3)).stage('finetune')
    reaches = [0.4, 0.4, 0.48, 20.0, 194.8, 194.8]
    higher = [{**line, 'reach': reach} for line, reach in zip(lines, reaches, strict=True)]
    *_, level, reach = training_figure(higher).axes
    assert level.get_ylabel() == 'level\n(1 to 8)'
    assert reach.lines[0].get_ydata() == pytest.approx(reaches)
    assert (reach.get_ylabel(), reach.get_yscale()) == ('highest\nstart (m)', 'log')
    assert (level.get_xlabel(), reach.get_xlabel()) == ('', 'iteration')


@pytest.mark.parametrize(('numbers', 'legend'), [
    ({}, 'final level, without noise'), ({'level': 7}, 'without noise'),
    ({'reach': 9.4}, 'whole task, without noise'),
    ({'level': 0, 'reach': 9.4}, 'whole task, without noise')])
def test_the_legend_says_what_is_flown_without_noise(
        tmp_path: Path, numbers: dict[str, float], legend: str) -> None:
    lines = [{**line, **numbers} for line in load(write_training(tmp_path)).stage('finetune')]
    for axes in training_figure(lines).axes[:2]:
        assert axes.get_legend_handles_labels()[1][-1] == legend


def test_every_axis_has_a_name_and_a_unit() -> None:
    """Or is a mere number, which then says so, or a count."""
    figures, episodes = _flown_table()
    for figure in (returns_figure(figures, episodes), fuel_figure(figures, episodes)):
        for axes in figure.axes:
            for text in (axes.get_xlabel(), axes.get_ylabel()):
                assert re.search(r'\(.+\)|per bin|^episode$|^$', text), text


def _flown_table() -> tuple[dict[str, object], EpisodeTable]:
    result = flown(level=8)
    return summarise(result), from_result(result)


def test_the_table_has_the_figures_and_their_intervals() -> None:
    figures, episodes = _flown_table()
    rows = {row[0]: row[1:] for row in figures_table.rows(figures, episodes)}
    assert rows['landed'][0] == '60 of 60, 100.00 %'
    assert rows['landed'][1] == '93.98 to 100.00 %'
    speed = episodes.numbers['touchdown_speed_m_s']
    low, high = bootstrap_mean(speed)
    assert rows['touchdown speed, mean'] == (
        f'{speed.mean():.4g} m/s', f'{low:.4g} to {high:.4g} m/s',
        f'95 % below {np.quantile(speed, 0.95):.4g} m/s')
    assert 'stands 60' in rows['standing in the end'][2]
    many = np.random.default_rng(0).normal(3.0, 2.0, 40_000)
    assert mean_interval(many) == pytest.approx(
        (many.mean() - 0.0196, many.mean() + 0.0196), abs=2e-4)


def test_thinning_keeps_the_first_and_the_last() -> None:
    chosen = np.ones(100, np.bool_)
    chosen[0] = False
    assert style.thin(chosen, 1000).tolist() == list(range(1, 100))
    some = style.thin(chosen, 10)
    assert (len(some), some[0], some[-1]) == (10, 1, 99)


@pytest.mark.usefixtures('unpainted')
@pytest.mark.parametrize(('name', 'text', 'words'), [
    ('evaluation.json', '{', 'evaluation.json: damaged'),
    ('evaluation.json', '[]', 'evaluation.json: damaged, expected an object'),
    ('evaluation.json', '{"world": 3}', 'evaluation.json: world: got 3, expected a string'),
    ('config.yaml', 'a: [', 'config.yaml: damaged'),
    ('config.yaml', 'training: 3', 'config.yaml: training: got 3, expected names and values'),
    ('train.jsonl', '{"stage": "clone"}\n{]\n', 'train.jsonl: line 2 is damaged'),
    ('train.jsonl', '[]\n', 'train.jsonl: line 1 is damaged: expected an object'),
    ('train.jsonl', '{}\n', "train.jsonl: line 1 is damaged: expected a 'stage'"),
    ('train.jsonl', '{"stage": "clone", "clone_loss": "low", "iteration": 1}\n',
     "clone_loss: got 'low', expected a number"),
    ('episodes.csv', 'row\n', 'episodes.csv: line 1: no column'),
])
def test_damaged_files_are_named(tmp_path: Path, name: str, text: str, words: str) -> None:
    folder = write_evaluation(write_training(tmp_path / 'run'), flown())
    (folder / name).write_text(text)
    with pytest.raises(ValueError, match=words.replace('[', r'\[')):
        report.write_report(folder)


@pytest.mark.parametrize(('name', 'value'), [
    ('touchdown_speed', 0.3), ('tilt', {'mean': 'low'}), ('standing_rate_interval', [1]),
    ('settling', ['stands']), ('fuel_ratio', '1.1'), ('world_settings', 3),
])
def test_figures_of_another_kind_are_named(tmp_path: Path, name: str, value: object) -> None:
    """Those that may be missing, too."""
    file = write_evaluation(tmp_path, flown()) / 'evaluation.json'
    figures = json.loads(file.read_text())
    assert name in figures
    file.write_text(json.dumps({**figures, name: None}))
    load(tmp_path)
    file.write_text(json.dumps({**figures, name: value}))
    with pytest.raises(ValueError, match=rf'evaluation\.json: {name}: got .*, expected '):
        load(tmp_path)


def test_a_folder_that_is_not_a_run_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match='nowhere: no such folder'):
        load(tmp_path / 'nowhere')
    (tmp_path / 'plots').mkdir()
    with pytest.raises(ValueError, match='plots: no run, expected a folder with'):
        load(tmp_path / 'plots')


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command as a process."""
    return subprocess.run(
        [sys.executable, '-m', 'ppo_agent_node.commands.report', *arguments],
        capture_output=True, text=True, timeout=110, check=False)


@pytest.mark.slow
def test_the_command_reports_and_compares(tmp_path: Path) -> None:
    runs = [write_training(tmp_path / f'seed {seed}', seed, 1) for seed in (1, 2)]
    done = command(*map(str, runs), f'output:={tmp_path / "all"}')
    assert (done.returncode, done.stderr) == (0, '')
    paths = [*(run / 'report.html' for run in runs), tmp_path / 'all' / 'report.html']
    assert done.stdout.splitlines() == [str(path) for path in paths]
    assert all(path.is_file() for path in paths)
    assert (tmp_path / 'all' / 'plots' / 'seeds.png').is_file()


def test_the_command_shows_no_escape_sequences(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    run = write_training(tmp_path / '\x1b[2J\n')
    monkeypatch.setattr(report, '_write', lambda run: run.path / 'config.yaml')  # no pictures
    monkeypatch.setattr(sys, 'argv', ['report', str(run)])
    report.main()
    (shown,) = capsys.readouterr().out.splitlines()
    assert shown.isprintable()
    bash = subprocess.run(
        ['bash', '-c', f'test -f {shown}'], capture_output=True, timeout=20, check=False)
    assert bash.returncode == 0, 'the path can be pasted'
    monkeypatch.setattr(sys, 'argv', ['report', str(tmp_path / 'none\x1b[2J')])
    with pytest.raises(SystemExit):
        report.main()
    assert capsys.readouterr().err.removesuffix('\n').isprintable()


def test_the_command_refuses_bad_arguments_in_one_line(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    run = str(write_training(tmp_path / 'run'))
    for arguments, words in (
            ([str(tmp_path)], f'{tmp_path}: no run'), (['colour:=red', run], "'colour'"),
            (['output:=there'], 'got no RUN'),
            ([run, 'output:=there'], "output: got 'there', expected none with one RUN")):
        monkeypatch.setattr(sys, 'argv', ['report', *arguments])
        with pytest.raises(SystemExit) as ended:
            report.main()
        said = capsys.readouterr()
        assert ended.value.code == 2
        assert words in said.err
        assert (said.err.count('\n'), said.out) == (1, '')
    assert not (tmp_path / 'run' / 'report.html').exists()
    monkeypatch.setattr(sys, 'argv', ['report', '--help'])
    report.main()
    assert capsys.readouterr().out.startswith('Usage: report RUN [RUN ...]')
    monkeypatch.setattr(sys, 'argv', ['report'])
    with pytest.raises(SystemExit) as ended:
        report.main()
    assert ended.value.code == 2
    assert capsys.readouterr().err.startswith('Usage: report RUN [RUN ...]')


def test_a_folder_that_cannot_be_made_is_refused_before_anything_is_drawn(tmp_path: Path) -> None:
    runs = [write_training(tmp_path / name) for name in ('one', 'two')]
    (tmp_path / 'file').touch()
    for output in (tmp_path / 'file', tmp_path / 'file' / 'below', Path('/proc/none')):
        with pytest.raises(ValueError, match=r'output: got .* expected a folder that can be made'):
            report._report([*map(str, runs), f'output:={output}'])
    assert not (tmp_path / 'one' / 'report.html').exists()


def test_every_picture_of_the_catalogue_has_a_short_caption() -> None:
    for name, entry in catalogue.CATALOGUE.items():
        assert entry.caption.endswith('.'), name
        assert entry.caption.count('. ') <= 2, name
