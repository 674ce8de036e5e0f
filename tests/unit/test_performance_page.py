# SPDX-License-Identifier: Apache-2.0
"""docs/performance.md is put together from the newest figures of each part."""
from __future__ import annotations

import json
from pathlib import Path

from benchmarks import performance
from benchmarks.performance_text import SECTIONS
from matplotlib.image import imread

HOSTS = {'256': {
    'within_median': 200.0, 'between_median': 300.0, 'ratio': 1.5, 'within_p99': 400.0,
    'between_p99': 500.0}}


def write(runs: Path, name: str, part: str, figures: dict, table: str) -> Path:
    folder = runs / name
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f'{part}.json').write_text(json.dumps(figures))
    (folder / f'{part}.txt').write_text(table)
    (folder / f'{part}.command').write_text(f'./launch_scripts/bench {part} --rounds 3\n')
    return folder


def test_the_newest_figures_are_taken_and_drawn(tmp_path: Path) -> None:
    write(tmp_path, 'bench-20260101-000000', 'hosts', {'hosts': {}}, 'an old table')
    folder = write(
        tmp_path, 'bench-20260102-000000', 'hosts', {'hosts': HOSTS}, 'a new table')
    (folder / 'machine.json').write_text(json.dumps({
        'date': '2026-01-02', 'commit': 'abc', 'cores': 2, 'processor': 'P', 'memory_gib': 1.0,
        'system': 'S', 'versions': {'python': '3', 'envpool': 'missing'}}))
    page = '\n'.join(performance.sections(tmp_path, tmp_path))
    assert 'a new table' in page
    assert 'an old table' not in page
    assert '`./launch_scripts/bench hosts --rounds 3`' in page
    assert '1.50 times one within the host' in page
    assert '2026-01-02, commit abc: 2 cores of P' in page
    assert 'envpool' not in page.split('## Two hosts')[1].split('##')[0]
    picture = imread(tmp_path / 'performance_hosts.png')
    assert picture[..., :3].std() > 0.05
    assert page.count('Not measured') == len(SECTIONS) - 1


def test_plots_that_a_part_drew_itself_are_kept(tmp_path: Path) -> None:
    folder = write(tmp_path / 'runs', 'bench-1', 'result', {}, 'table')
    (folder / 'result_rocket.png').write_bytes(b'picture')
    page = '\n'.join(performance.sections(tmp_path / 'runs', tmp_path))
    assert 'images/performance_result_rocket.png' in page
    assert (tmp_path / 'performance_result_rocket.png').read_bytes() == b'picture'
