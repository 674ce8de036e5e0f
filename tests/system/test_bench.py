# SPDX-License-Identifier: Apache-2.0
"""The benchmarks run and write what they measured. What they measure is not asserted here."""
from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip('Box2D')
TESTS = Path(__file__).resolve().parents[1]


def run(part: str, output: Path, *options: str) -> tuple[str, dict]:
    """Run a part in a process of its own, as the command does."""
    path = os.pathsep.join(filter(None, (str(TESTS), os.environ.get('PYTHONPATH'))))
    done = subprocess.run(
        [sys.executable, '-m', f'benchmarks.{part}', '--output', str(output), *options],
        env={**os.environ, 'PYTHONPATH': path}, capture_output=True, text=True, timeout=100,
        check=True)
    return done.stdout, json.loads(output.read_text('utf-8'))


def test_heuristic(tmp_path: Path) -> None:
    text, figures = run('heuristic', tmp_path / 'out.json', '--episodes', '20')
    assert [kind['action'] for kind in figures] == ['discrete', 'continuous']
    for kind in figures:
        low, high = kind['difference_interval']
        assert low <= kind['difference'] <= high
        assert kind['difference'] == pytest.approx(
            kind['ours']['mean'] - kind['theirs']['mean'])
        assert sum(kind['our_outcomes'].values()) == 20
        assert sum(kind['their_outcomes'].values()) == 20
    assert 'published' in text


def test_stepping(tmp_path: Path) -> None:
    text, figures = run(
        'stepping', tmp_path / 'out.json', '--sizes', '1', '4', '--rounds', '1', '--seconds',
        '0.05')
    assert set(figures['steps_per_second']['ours']) == {'1', '4'}
    assert figures['best']['ours'] == max(figures['steps_per_second']['ours'].values())
    assert figures['ratios']['Gymnasium'] == pytest.approx(
        figures['best']['ours'] / figures['best']['Gymnasium'])
    assert 'x Gymnasium' in text


def test_recorder(tmp_path: Path) -> None:
    text, figures = run(
        'recorder', tmp_path / 'out.json', '--turns', '1', '--seconds', '0.5', '--parts', 'flying')
    flying = figures['flying']
    assert flying['ratio'] == pytest.approx(flying['with'] / flying['without'])
    assert flying['turns'] == 1
    assert 'flying' in text


def test_exchange(tmp_path: Path) -> None:
    text, figures = run(
        'exchange', tmp_path / 'out.json', '--sizes', '1', '--rounds', '1', '--count', '20')
    one = figures['exchange']['1']
    assert one['ratio'] == pytest.approx(one['dds'] / one['tcp'])
    assert 'TCP' in text


def test_stopping(tmp_path: Path) -> None:
    text, figures = run(
        'stopping', tmp_path / 'out.json', '--stages', 'starting', '--rounds', '1')
    assert set(figures) == {'starting'}
    assert '1 of 1' in text


def test_result(tmp_path: Path) -> None:
    pytest.importorskip('envpool')
    # Any policy returns so much.
    text, figures = run(
        'result', tmp_path / 'out.json', '--worlds', 'lunar_lander', '--contestants', 'ours',
        'envpool_ppo', '--seeds', '3', '--target', '-100000', '--verify', '20')
    lander = figures['lunar_lander']
    assert [run['contestant'] for run in lander['runs']] == ['ours', 'envpool_ppo']
    for flown in lander['runs']:
        assert flown['passed']
        assert flown['seconds'] > flown['learning_seconds'] > 0
        assert flown['gymnasium']['episodes'] == 20
        assert flown['evaluations'][-1]['seconds'] == pytest.approx(flown['seconds'])
    ours, peer = (lander['summary'][name]['seconds'] for name in ('ours', 'envpool_ppo'))
    assert lander['ratios'] == {'envpool_ppo': pytest.approx(peer / ours)}
    assert 'PPO on EnvPool takes' in text
    assert (tmp_path / 'out_lunar_lander.png').stat().st_size > 10_000
