# SPDX-License-Identifier: Apache-2.0
"""docs/results/performance.md is put together from the newest figures of each part."""
from __future__ import annotations

import json
from pathlib import Path

import pytest
from benchmarks.reports import performance
from benchmarks.reports import performance_plots
from benchmarks.reports.performance_text import SECTIONS
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
    page = '\n'.join(performance.sections(tmp_path, tmp_path, ''))
    assert 'a new table' in page
    assert 'an old table' not in page
    assert '`./launch_scripts/bench hosts --rounds 3`' in page
    assert '1.50 times as long as one within the host' in page
    assert '2026-01-02, commit abc: 2 cores of P' in page
    assert 'envpool' not in page.split('## Two hosts')[1].split('##')[0]
    picture = imread(tmp_path / 'performance_hosts.png')
    assert picture[..., :3].std() > 0.05
    assert page.count('Not measured') == len(SECTIONS) - 1


def test_each_world_has_its_newest_figures_and_the_plots_that_the_part_drew(
    tmp_path: Path,
) -> None:
    for name, world, table in (
            ('bench-1', 'lunar_lander', 'old lander'), ('bench-2', 'lunar_lander', 'new lander'),
            ('bench-3', 'rocket', 'rocket')):
        folder = write(tmp_path / 'runs', name, 'result', {world: {'cap': 180.0}}, table)
        (folder / f'result_{world}.png').write_bytes(name.encode())
    page = '\n'.join(performance.sections(tmp_path / 'runs', tmp_path, ''))
    lander, rocket = (
        page.split(f'## {title}\n')[1].split('\n## ')[0]
        for title in ('Time to a result', 'Time to a result: the rocket'))
    assert 'new lander' in lander
    assert 'images/performance_result_lunar_lander.png' in lander
    assert 'old lander' not in page
    assert 'rocket.png' not in lander
    assert 'images/performance_result_rocket.png' in rocket
    assert 'two simulators' in rocket
    assert (tmp_path / 'performance_result_lunar_lander.png').read_bytes() == b'bench-2'


def test_a_part_without_figures_stays_as_it_is(tmp_path: Path) -> None:
    write(tmp_path, 'bench-1', 'hosts', {'hosts': HOSTS}, 'a table')
    before = (
        '# Performance\n\n## Recorders and views\n\nIt costs nothing.\n\n```\n# table\n```\n\n'
        '## Two hosts\n\nstale\n')
    page = '\n'.join(performance.sections(tmp_path, tmp_path, before))
    assert '## Recorders and views\n\nIt costs nothing.\n\n```\n# table\n```\n' in page
    assert 'stale' not in page
    assert 'a table' in page
    again = '\n'.join(performance.sections(tmp_path, tmp_path, page))
    assert again == page


def test_figures_of_an_older_benchmark_leave_the_section_as_it_is(tmp_path: Path) -> None:
    write(tmp_path, 'bench-1', 'heuristic', [], 'a table')  # type: ignore[arg-type]
    before = "# Performance\n\n## Gymnasium's pilot in our lander\n\nIt flies.\n"
    page = '\n'.join(performance.sections(tmp_path, tmp_path, before))
    assert 'It flies.' in page
    assert 'a table' not in page


def test_text_of_roll_outs_and_many_simulators() -> None:
    speed = {'in process, 1': 100.0, 'in process, 2': 80.0}
    said = SECTIONS['rollouts'][1]({'rollouts': {
        size: {'steps_per_second': speed, 'ratio': {'DDS, 2': ratio},
               'ratio_of_equals': {'DDS, 2': ratio / 0.8}, 'dds_parts': 0.75, 'tcp_parts': 0.95,
               'ratio_apart': 0.45}
        for size, ratio in (('256', 0.4), ('4096', 0.72))}})
    assert '0.40 with 256, 0.72 with 4096 rockets' in said
    assert '0.50 with 256, 0.90 with 4096' in said
    assert '0.80 with 256' in said
    said = SECTIONS['fleet'][1]({
        'fleet': {
            '1': {'cpu_us': 100.0, 'ratio': 1.0, 'wall_us': 300.0},
            '16': {'cpu_us': 90.0, 'ratio': 0.9, 'wall_us': 280.0}},
        'wire_us': 200.0, 'inference_us': 300.0, 'physics_us': 100.0,
        'bytes_per_exchange': 20_000})
    assert '300 us with 1, 280 us with 16' in said
    assert '1.6 simulators keep it busy' in said


@pytest.mark.parametrize(('part', 'figures', 'title'), [
    ('exchange', {'exchange': {'256': {'ratio_apart': 2.04}}}, 'takes 2.0 times'),
    ('budget', {'num_envs': 256, 'budget': [
        {'who': 'agent', 'what': 'inference: features', 'us': 20.0},
        {'who': 'agent', 'what': 'inference: network', 'us': 40.0},
        {'who': 'between', 'what': 'DDS', 'us': 40.0}, {'who': '', 'what': 'whole', 'us': 100.0}]},
     'Inference takes 60% of a step of 256 rockets,\nDDS and the kernel 40%'),
    ('rollouts', {'rollouts': {
        '256': {'ratio': {'DDS, 2': 0.41}}, '4096': {'ratio': {'DDS, 2': 0.99}}}},
     '41% with 256, 99% with 4,096'),
    ('fleet', {'fleet': {'1': {'ratio': 1.0}, '16': {'ratio': 0.6}}},
     'With 16 simulators, an exchange costs the agent\n0.60 times'),
    ('stepping', {'ratios': {'lunar_lander': {'EnvPool': 3.94}}}, '3.9 times as many steps'),
    ('threads', {'threads': [
        {'threads': 2, 'gain': 1.1, 'size': 64, 'world': 'rocket'},
        {'threads': 2, 'gain': 1.54, 'size': 256, 'world': 'lunar_lander'}]},
     'up to 1.54 times as fast as one: 256 of lunar_lander'),
    ('learner', {'learner': [
        {'samples_per_second': {'ours': 9.0}, 'SB3': 3.2, 'ratio': 3.0},
        {'samples_per_second': {'ours': 22.0}, 'SB3': 2.2, 'ratio': 11.0}]}, '3.0 to 11.0 times'),
    ('learner', {'learner': [{'samples_per_second': {'ours': 9.0}}]}, 'of the bare products'),
    ('recorder', {'ros_bridge, training': {'ratio': 0.956}}, 'run\nat 96% of'),
])
def test_titles_state_the_finding(part: str, figures: dict, title: str) -> None:
    assert title in performance_plots.FINDINGS[part](figures)


def test_the_text_says_what_limits_small_batches() -> None:
    figures: dict = {
        'ratios': {name: {'EnvPool': 3.9} for name in ('rocket', 'lunar_lander')}, 'limits': {
            'sizes': [1, 4], 'pymunk_share': [0.25, 0.3], 'operation': 0.5,
            'step': {'lunar_lander': [100.0, 120.0], 'rocket': [60.0, 61.0],
                     'EnvPool': [40.0, 95.0]}}}
    text = SECTIONS['stepping'][1](figures)
    assert "pymunk's own calls take 25 us. The remaining " in text
    assert "EnvPool's whole step takes 40 us." in text
    assert 'so these times are those of 150 and 120 such operations' in text
    assert 'pymunk' not in SECTIONS['stepping'][1](
        {'ratios': figures['ratios']})


def test_text_and_pictures_of_the_other_parts(tmp_path: Path) -> None:
    lossy = {'p50': 0.6, 'p99': 4.3, 'typical_p99': 4.0, 'p999': 9.0, 'equal': True}
    kind = {'action': 'discrete', 'difference': -13.4, 'difference_interval': [-32.9, 6.2],
            'ours': {'mean': 239.7}, 'theirs': {'mean': 253.1}}
    figures = {
        'loss': ({'loss': {'0.01': lossy}}, 'the same, bit for bit', '4.3 ms with 1% lost'),
        'heuristic': ({'heuristic': [kind]}, '-13.4 (-32.9 to +6.2) with discrete actions'),
        'transfer': (
            {'ours': 283.4, 'gymnasium': 280.1, 'difference': 3.3,
             'difference_interval': [-1.0, 7.6]}, '283.4 here, 280.1 there, difference +3.3'),
        'stopping': ({'update': [1.0, 2.0, 1.5]}, 'Seconds from Ctrl-C'),
        'key_latency': (
            {'median_ms': 29.7, 'latencies_ms': [20.0, 29.7, 40.0]}, 'median 29.7 ms'),
    }
    for part, (found, *_) in figures.items():
        write(tmp_path, 'bench-1', part, found, 'a table')
    page = '\n'.join(performance.sections(tmp_path, tmp_path, ''))
    for part, (_, *said) in figures.items():
        for words in said:
            assert words in page
        assert imread(tmp_path / f'performance_{part}.png')[..., :3].std() > 0.05
    assert 'NOT ALL' in SECTIONS['loss'][1]({'loss': {'0.01': {**lossy, 'equal': False}}})


def test_each_picture_has_a_title() -> None:
    assert performance_plots.PLOTS.keys() == performance_plots.FINDINGS.keys()
