# SPDX-License-Identifier: Apache-2.0
"""`bench examples` trains each example once, and writes and draws what it found."""
from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from benchmarks.learning import examples
from benchmarks.learning.examples_run import ReachedError
from benchmarks.learning.examples_run import Recorder


def call(monkeypatch: pytest.MonkeyPatch, *arguments: str | Path) -> None:
    monkeypatch.setattr(sys, 'argv', ['bench examples', *map(str, arguments)])
    examples.main()


@pytest.mark.slow
def test_runs_are_trained_once_and_put_on_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    page = tmp_path / 'docs' / 'results' / 'libraries.md'
    page.parent.mkdir(parents=True)
    (page.parents[1] / 'images').mkdir()
    page.write_text(''.join(
        f'before {world}\n<!-- {world} -->\nold\n<!-- end of {world} -->\n'
        for world in examples.STEPS))
    monkeypatch.setattr(examples, 'PAGE', page)
    arguments = (
        '--examples', 'single_file_ppo', '--seeds', '7', '--steps', '40000', '--runs',
        tmp_path / 'runs', '--page', '--output', tmp_path / 'examples.json')
    call(monkeypatch, *arguments)
    figures = json.loads((tmp_path / 'examples.json').read_text())
    for world in examples.STEPS:
        run, = figures[world]['runs']
        assert run['seed'] == 7 and not run['passed']
        assert run['steps'] >= 32_768
        assert run['curve'][0]['steps'] < run['curve'][-1]['steps'] == run['steps']
        assert (tmp_path / f'examples_{world}.png').stat().st_size > 10_000
        assert (page.parents[1] / 'images' / f'examples_{world}.png').is_file()
    assert figures['rocket']['runs'][0]['reach'] >= 0.4
    text = page.read_text()
    assert 'old' not in text and 'before rocket' in text
    assert '| PPO in a single file | 7 ' in ' '.join(text.split())
    assert '--worlds rocket --examples single_file_ppo --seeds 7 --steps 40000`' in text
    monkeypatch.setattr(examples.subprocess, 'run', None)
    call(monkeypatch, *arguments)
    assert page.read_text() == text
    with pytest.raises(ValueError, match='trained with 40000 steps instead of 5'):
        call(monkeypatch, *arguments, '--steps', '5')
    capsys.readouterr()


def test_a_run_is_left_when_it_has_reached_the_target() -> None:
    recorder = Recorder(target=1.0, most_steps=10_000)
    final = {'episode_return': np.zeros(50), 'is_success': np.ones(50, bool)}
    ended = {'final_info': final, '_final_info': np.ones(50, bool)}
    recorder.stepped(50, ended)
    recorder.stepped(50, ended)
    assert [point['steps'] for point in recorder.curve] == [100]
    assert recorder.curve[0]['landed'] == 1.0
    final['episode_return'] += 1.0
    recorder.stepped(50, ended)
    with pytest.raises(ReachedError):
        recorder.stepped(50, ended)
    assert recorder.passed and recorder.steps == 200


def test_a_run_is_left_when_its_steps_are_used_up() -> None:
    recorder = Recorder(target=1.0, most_steps=100)
    recorder.stepped(50, {})
    with pytest.raises(ReachedError):
        recorder.stepped(50, {})
    assert not recorder.passed
