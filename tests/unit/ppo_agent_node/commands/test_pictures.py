# SPDX-License-Identifier: Apache-2.0
"""The command that makes the pictures of the documents."""
from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.recording import rendering

from ppo_agent_node.commands import pictures
from rocket_sim_node import palette
from rocket_sim_node.recording.reader import trajectories

ROOT = Path(__file__).parents[4]


@pytest.mark.slow
def test_the_command_makes_a_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    # Drawn as tests draw: left out, visibly, where there is no driver.
    monkeypatch.setattr(pictures, 'render', lambda path, times, size: [
        Image.fromarray(picture.astype(np.uint8)) for picture in rendering.pictures(
            path, times, size=(960, 600))])
    monkeypatch.setattr(sys, 'argv', ['pictures', 'only:=lunar_lander', f'output:={tmp_path}'])
    pictures.main()
    assert 'lunar_lander.png, 960 x 532' in capsys.readouterr().out
    with Image.open(tmp_path / 'lunar_lander.png') as picture:
        pixels = np.asarray(picture.convert('RGB'), np.int64)
    assert rendering.of_vehicle(pixels[:, :480], 'lunar_lander').sum() > 50


@pytest.mark.slow
def test_standard_views_are_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, 'argv', ['pictures', 'only:=standard_views', f'output:={tmp_path}'])
    pictures.main()
    assert 'standard_views.png, 1800 x 960' in capsys.readouterr().out
    with Image.open(tmp_path / 'standard_views.png') as picture:
        pixels = np.asarray(picture.convert('RGB'), np.int64)
    for colour in (palette.CONCRETE, palette.TARGET, palette.BURN, palette.GREEN):
        near = np.abs(pixels - colour).max(axis=2) < 12
        assert near.sum() > 20, colour


def test_the_recorded_flight_is_the_same_every_time(tmp_path: Path) -> None:
    for name in ('a', 'b'):
        pictures.fly_and_record('lunar_lander', tmp_path / f'{name}.rrd')
    first, second = (trajectories(tmp_path / f'{name}.rrd') for name in ('a', 'b'))
    assert len(first) == len(second) == 1
    for one, other in zip(first, second, strict=True):
        assert (one.row, one.start) == (other.row, other.start)
        np.testing.assert_array_equal(one.position, other.position)


def test_the_documents_show_all_pictures_made_by_the_command() -> None:
    shown = {
        Path(target).stem for page in (ROOT / 'README.md', *(ROOT / 'docs').rglob('*.md'))
        for target in re.findall(r'\]\(((?:docs|\.\.)/images/[^)/]+)\)', page.read_text())}
    drawn = {path.stem for path in (ROOT / 'docs' / 'images').iterdir()} & set(pictures.MAKERS)
    assert {'landing', 'lunar_lander', 'comparison', 'cloning', 'training'} <= drawn
    assert drawn <= shown


def test_the_newest_complete_run_is_taken(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match='run_dir: no finished run'):
        pictures.newest_run(tmp_path)
    for age, (name, world) in enumerate((
            ('new', 'rocket'), ('old', 'rocket'), ('moon', 'lunar_lander'))):
        folder = tmp_path / name
        folder.mkdir()
        (folder / 'config.yaml').write_text(f'world: {world}\n')
        for file in pictures.COMPLETE:
            (folder / file).touch()
        os.utime(folder / 'evaluation.json', (1000 - age, 1000 - age))
    (tmp_path / 'under_way').mkdir()
    (tmp_path / 'under_way' / 'config.yaml').write_text('world: rocket\n')
    assert pictures.newest_run(tmp_path).name == 'new'


@pytest.mark.parametrize(('arguments', 'complaint'), [
    (['only:=sunset'], "only: got 'sunset', expected one of"),
    (['only:=training', 'run_dir:=/nowhere'], '/nowhere'),
    (['only:=comparison', 'run_dir:=/nowhere'], '/nowhere'),
])
def test_bad_arguments_are_named(
    tmp_path: Path, arguments: list[str], complaint: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, 'argv', ['pictures', f'output:={tmp_path}', *arguments])
    with pytest.raises(SystemExit) as end:
        pictures.main()
    assert end.value.code == 2
    assert complaint in capsys.readouterr().err
