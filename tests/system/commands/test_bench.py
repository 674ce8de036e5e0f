# SPDX-License-Identifier: Apache-2.0
"""The benchmarks run and write their figures. The figures are not asserted here."""
from __future__ import annotations

import dataclasses
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
import torch
from benchmarks.networks.learner_sides import CASES
from benchmarks.networks.learner_sides import Case
from benchmarks.networks.learner_sides import Options
from benchmarks.networks.learner_sides import Ours
from benchmarks.networks.learner_sides import StableBaselines3
from benchmarks.parts import MODULES
from support.network.hosts import missing
from support.network.hosts import missing_loss
from support.processes import Processes

pytest.importorskip('Box2D')
TESTS = Path(__file__).resolve().parents[2]


def run(part: str, output: Path, *options: str) -> tuple[str, dict]:
    """Run a part in a process of its own, as the command does."""
    path = os.pathsep.join(filter(None, (str(TESTS), os.environ.get('PYTHONPATH'))))
    with subprocess.Popen(
            [sys.executable, '-m', MODULES[part], '--output', str(output), *options],
            env={**os.environ, 'PYTHONPATH': path}, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, start_new_session=True) as benchmark:
        try:
            text, _ = benchmark.communicate(timeout=100)
        except BaseException as error:
            benchmark.send_signal(signal.SIGINT)  # it has nodes to end
            try:
                text, _ = benchmark.communicate(timeout=10)
            except subprocess.TimeoutExpired:
                text = ''
                benchmark.kill()
            if isinstance(error, KeyboardInterrupt):
                raise
            raise AssertionError(f'{part} did not end: {error}\n{text}') from error
    assert benchmark.returncode == 0, text
    return text, json.loads(output.read_text('utf-8'))


@pytest.fixture
def long_enough(nightly: bool) -> None:
    """Skip a benchmark that takes longer than the others and shares their code."""
    if not nightly:
        pytest.skip('a benchmark of 15 to 30 s: --nightly')


def test_heuristic(tmp_path: Path) -> None:
    text, figures = run('heuristic', tmp_path / 'out.json', '--episodes', '20')
    figures = figures['heuristic']
    assert [kind['action'] for kind in figures] == ['discrete', 'continuous']
    for kind in figures:
        low, high = kind['difference_interval']
        assert low <= kind['difference'] <= high
        assert kind['difference'] == pytest.approx(
            kind['ours']['mean'] - kind['theirs']['mean'])
        assert sum(kind['our_outcomes'].values()) == 20
        assert sum(kind['their_outcomes'].values()) == 20
    assert 'published' in text


@pytest.mark.usefixtures('nightly_only')
def test_the_time_of_the_rocket(tmp_path: Path) -> None:
    text, figures = run(
        'result', tmp_path / 'out.json', '--worlds', 'rocket', '--rocket-seeds', '11')
    assert figures['rocket']['summary']['passed'] == 1
    assert '1 of 1 land 99 %' in text


def test_seeds_that_settings_were_chosen_on_are_refused() -> None:
    path = os.pathsep.join(filter(None, (str(TESTS), os.environ.get('PYTHONPATH'))))
    refused = subprocess.run(
        [sys.executable, '-m', MODULES['result'], '--seeds', '3', '11'],
        env={**os.environ, 'PYTHONPATH': path}, capture_output=True, text=True, timeout=60.0,
        check=False)
    assert refused.returncode == 2
    assert 'seeds: got 3, expected none of 1 to 10' in refused.stderr


def test_stepping(tmp_path: Path) -> None:
    text, figures = run(
        'stepping', tmp_path / 'out.json', '--sizes', '1', '4', '--rounds', '1', '--seconds',
        '0.05')
    for world in ('lunar_lander', 'rocket'):
        assert set(figures['steps_per_second'][world]) == {'1', '4'}
        assert figures['best'][world] == max(figures['steps_per_second'][world].values())
        assert figures['ratios'][world]['Gymnasium'] == pytest.approx(
            figures['best'][world] / figures['best']['Gymnasium'])
    assert 'x Gymnasium' in text


def test_threads(tmp_path: Path) -> None:
    text, figures = run('threads', tmp_path / 'out.json', '--sizes', '8', '--steps', '5')
    assert [row['world'] for row in figures['threads']] == ['lunar_lander', 'rocket']
    for row in figures['threads']:
        assert row['gain'] == pytest.approx(row['fast'][0] / row['fast'][1])
    assert '2 threads' in text


def test_peers(tmp_path: Path) -> None:
    ours = ['ours, lunar_lander', 'ours, rocket', 'ours, rocket_planar']
    text, figures = run(
        'peers', tmp_path / 'out.json', '--rounds', '1', '--seconds', '0.02', '--only', *ours,
        'Gymnasium LunarLander', 'PyFlyt Rocket-Landing')
    for name in ours:
        assert figures['exact'][name] == {
            'same process': 'same bits', 'other process': 'same bits', 'copy': 'same bits'}
        assert min(figures['steps_per_second'][name].values()) > 0
    assert figures['exact']['Gymnasium LunarLander']['same process'] == 'same bits'
    for name, reason in figures['missing'].items():  # PyFlyt, unless the command installed it
        assert f'{name}: not measured: {reason}' in text


def test_onnx(tmp_path: Path, long_enough: None) -> None:
    pytest.importorskip('onnxscript')
    text, figures = run(
        'onnx', tmp_path / 'out.json', '--sizes', '1', '8', '--rounds', '1', '--seconds', '0.01',
        '--policies', 'lunar_lander')
    assert [each['batch'] for each in figures['figures']] == [1, 8]
    for each in figures['figures']:
        times = each['microseconds']
        assert each['ratio'] == pytest.approx(times['torch'] / times['onnx'])
    assert 'torch / onnx' in text


def test_recorder(tmp_path: Path, long_enough: None) -> None:
    text, figures = run(
        'recorder', tmp_path / 'out.json', '--turns', '2', '--seconds', '0.5', '--parts', 'flying',
        '--nodes', 'bag_recorder', 'ros_bridge')
    flying = figures['bag_recorder, flying']
    assert flying['recorded'] > 100
    assert figures['ros_bridge, flying']['recorded'] == 0
    assert len(flying['all_with']) == flying['turns'] == 2
    before, between, after = flying['all_without']
    first, second = flying['all_with']
    assert flying['ratio']**2 == pytest.approx(
        first * second / between / (before * after)**0.5)
    assert flying['low'] < flying['ratio'] < flying['high']
    assert 'ros_bridge, flying' in text


def test_exchange(tmp_path: Path) -> None:
    text, figures = run(
        'exchange', tmp_path / 'out.json', '--sizes', '1', '--rounds', '1', '--count', '20')
    one = figures['exchange']['1']
    assert one['ratio'] == pytest.approx(one['dds'] / one['tcp'])
    assert 'TCP' in text


@pytest.mark.parametrize('variant', ['unchecked', 'rosidl'])
def test_exchange_with_a_variant(
        tmp_path: Path, request: pytest.FixtureRequest, variant: str) -> None:
    if variant == 'rosidl':
        request.getfixturevalue('nightly_only')
    text, figures = run(
        'exchange', tmp_path / 'out.json', '--variant', variant, '--sizes', '8', '--rounds', '2',
        '--count', '20')
    one = figures[variant]['8']
    assert one['low'] <= one['ratio'] <= one['high']
    assert one['as_it_is'] > 0 and one[variant] > 0
    assert text.startswith('batch 8: ')


@pytest.mark.usefixtures('nightly_only')
def test_carriers(tmp_path: Path) -> None:
    text, figures = run(
        'carriers', tmp_path / 'out.json', '--rounds', '1', '--count', '20', '--sizes', '8',
        '--only', 'Fast DDS: SHM')
    assert [row['carrier'] for row in figures['carriers']] == ['ours', 'Fast DDS: SHM']
    assert all(row['us'] > 0 and not row['failed'] for row in figures['carriers'])
    assert 'x ours' in text


def test_discovery(tmp_path: Path) -> None:
    text, figures = run('discovery', tmp_path / 'out.json', '--counts', '4')
    assert [row['known'] for row in figures['discovery']] == [4, 4]
    assert 'the last knows' in text


def test_learner(tmp_path: Path, long_enough: None) -> None:
    text, figures = run(
        'learner', tmp_path / 'out.json', '--cases', '1', '--rounds', '1', '--threads', '1',
        '--samples', '1024')
    one, = figures['learner']
    rates = one['samples_per_second']
    assert one['part_of_floor']['ours'] == pytest.approx(rates['ours'] / one['floor'])
    assert one['floor'] == max(
        rate for name, rate in rates.items() if name.startswith('floor'))
    if 'SB3' in rates:
        assert one['ratio'] == pytest.approx(rates['ours'] / one['SB3'])
        assert one['told']['SB3']['value_loss'] == pytest.approx(
            one['told']['ours']['value_loss'], rel=0.2)
    assert 'lunar_lander, minibatch 512' in text


@pytest.mark.parametrize('case', CASES[:2], ids=str)
def test_the_learner_computes_the_losses_of_stable_baselines3(case: Case) -> None:
    """One minibatch, so that the order does not matter; one rate and no clipping, as it has."""
    pytest.importorskip('stable_baselines3')
    case = dataclasses.replace(case, batch_size=2048)
    options = Options(case, threads=1, device='cpu', samples=2048)
    before = torch.get_num_threads()
    same = {
        'n_epochs': 4, 'max_grad_norm': 1e9, 'actor_learning_rate': 1e-3, 'log_std_final': 20.0,
        'critic_learning_rate': 1e-3, 'log_std_learning_rate': 1e-3, 'features': 'none',
        'hidden_observations': '', 'start_copies': 1}
    ours, theirs = Ours(options, **same), StableBaselines3(options, **same)
    assert ours.update() == pytest.approx(theirs.update(), rel=1e-5, abs=1e-6)
    for layers, network in zip(
            theirs.layers, (ours.learner.policy, ours.learner.critic), strict=True):
        linear = [m for m in network.modules() if isinstance(m, torch.nn.Linear)]
        for one, other in zip(linear, layers, strict=True):
            torch.testing.assert_close(one.weight, other.weight, rtol=1e-4, atol=1e-5)
    torch.set_num_threads(before)


def test_stopping(tmp_path: Path) -> None:
    text, figures = run(
        'stopping', tmp_path / 'out.json', '--stages', 'starting', '--rounds', '1')
    assert set(figures) == {'starting'}
    assert '1 of 1' in text


def test_rollouts(tmp_path: Path) -> None:
    text, figures = run(
        'rollouts', tmp_path / 'out.json', '--sizes', '8', '--rounds', '1', '--steps', '20')
    one = figures['rollouts']['8']
    assert one['equal'] is True
    assert one['ratio']['in process, 1'] == 1.0
    assert 'two sim.' in text


def test_fleet(tmp_path: Path) -> None:
    text, figures = run(
        'fleet', tmp_path / 'out.json', '--counts', '1', '2', '--num-envs', '2', '--steps', '20',
        '--rounds', '1')
    assert set(figures['fleet']) == {'1', '2'}
    assert all(0 < row['cpu_us'] < 1e6 for row in figures['fleet'].values())
    assert 'agent CPU' in text


@pytest.mark.usefixtures('nightly_only')
@pytest.mark.skipif(bool(missing()), reason=missing())
def test_hosts(tmp_path: Path) -> None:
    text, figures = run(
        'hosts', tmp_path / 'out.json', '--sizes', '2', '--rounds', '1', '--count', '20')
    two = figures['hosts']['2']
    assert 0 < two['within_median'] <= two['within_p99'] < 1e6
    assert 0 < two['between_median'] <= two['between_p99'] < 1e6
    assert 'two hosts' in text


@pytest.mark.skipif(bool(missing()), reason=missing())
def test_ranks(tmp_path: Path, long_enough: None) -> None:
    text, figures = run(
        'ranks', tmp_path / 'out.json', '--groups', '2', '--rounds', '1', '--iterations', '1',
        '--delays', '1')
    found = figures['ranks']
    assert set(found['rows']) == {'one rank', 'two ranks', 'two ranks, 1 ms'}
    assert found['rows']['two ranks, 1 ms']['sum'] > 0.002  # s, there and back
    assert 'speed-up' in text


@pytest.mark.usefixtures('nightly_only')
@pytest.mark.skipif(bool(missing_loss()), reason=missing_loss())
def test_loss(tmp_path: Path) -> None:
    text, figures = run(
        'loss', tmp_path / 'out.json', '--shares', '0.05', '--num-envs', '2', '--rounds', '1',
        '--count', '200')
    assert figures['loss']['0.05']['steps'] == 200
    assert figures['loss']['0.05']['equal']
    assert 'packets lost' in text


def test_budget(tmp_path: Path) -> None:
    text, figures = run(
        'budget', tmp_path / 'out.json', '--num-envs', '8', '--rounds', '2', '--steps', '20')
    rows = {row['what']: row['us'] for row in figures['budget']}
    assert {'inference: network', 'physics', 'whole step'} <= rows.keys()
    assert 'TCP, a core each' in text


def test_rollouts_that_are_terminated_leave_no_simulators(processes: Processes) -> None:
    runs, mark = TESTS.parent / 'runs', f'--rounds {10**7 + os.getpid()}'
    bench = processes.start(
        str(TESTS.parent / 'launch_scripts' / 'bench'), 'rollouts', '--sizes', '8', '--steps',
        '20', *mark.split())
    try:
        bench.wait_for('/sim_1 has joined', 60.0)
        nodes = psutil.Process(bench.pid).children(recursive=True)
        assert any('lib/rocket_sim_node/simulator' in ' '.join(one.cmdline()) for one in nodes)
        os.kill(bench.pid, signal.SIGTERM)
        assert bench.wait(20.0) == 143, bench.output()
        assert psutil.wait_procs(nodes, timeout=5.0)[1] == []
        assert 'Traceback' not in bench.output()
    finally:
        for file in runs.glob('bench-*/rollouts.command'):
            if mark in file.read_text():
                shutil.rmtree(file.parent)


def test_an_interrupted_soak_ends_its_nodes_and_writes_figures(
        processes: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        long_enough: None) -> None:
    monkeypatch.setenv('PYTHONPATH', os.pathsep.join(
        filter(None, (str(TESTS), os.environ.get('PYTHONPATH')))))
    output = tmp_path / 'out.json'
    soak = processes.start(
        sys.executable, '-m', 'benchmarks.reliability.soak', '--every', '2', '--period', '0.5',
        '--num-envs', '4', '--steps', '16', '--output', str(output))
    soak.wait_for('killed', 100.0)
    soak.signal(signal.SIGTERM)
    assert soak.wait(60.0) == 0, soak.output()
    figures = json.loads(output.read_text('utf-8'))
    assert figures['ended'].keys() == {
        'sim_0', 'sim_1', 'recorder_0', 'recorder_1', 'agent'}
    # One that had just been started may not have been ready to be asked: the signal ends it then,
    # or Python does, with 1, where it was itself just starting.
    young = set(re.findall(r'(\w+) killed', soak.output()))
    assert {status for name, status in figures['ended'].items() if name not in young} == {0}
    assert {figures['ended'][name] for name in young} <= {0, 1, 130, -signal.SIGINT}
    assert figures['unexpected'] == []
    assert 0 < figures['minutes'] < figures['planned_minutes'] == 60
    rows = {(row['what'], row['of']) for row in figures['slopes']}
    assert {('memory of its own, MiB', 'agent'), ('open files', 'sim_0'),
            ('steps/s', 'all')} <= rows
    assert 'interrupted' in soak.output()
    assert (tmp_path / 'out_samples.csv').read_text('utf-8').count('agent') > 0
    assert (tmp_path / 'out_curves.png').stat().st_size > 10_000


def test_result(tmp_path: Path) -> None:
    pytest.importorskip('envpool')
    # Any policy returns so much, and is evaluated even if none lands.
    text, figures = run(
        'result', tmp_path / 'out.json', '--worlds', 'lunar_lander', '--contestants', 'ours',
        'ours_from_scratch', 'envpool_ppo', '--seeds', '13', '--target', '-100000', '--verify',
        '20', '--set', 'selection_from_landing_rate=0.0')
    lander = figures['lunar_lander']
    names = ['ours', 'ours_from_scratch', 'envpool_ppo']
    assert [run['contestant'] for run in lander['runs']] == names
    for flown in lander['runs']:
        assert flown['passed']
        assert flown['evaluations'][-1]['steps'] > 0
        assert flown['seconds'] > flown['learning_seconds'] > 0
        assert flown['gymnasium']['episodes'] == 20
        assert flown['evaluations'][-1]['seconds'] == pytest.approx(flown['seconds'])
    imitated, alone, peer = (lander['summary'][name]['seconds'] for name in names)
    assert lander['ratios'] == {
        'ours': {'envpool_ppo': pytest.approx(imitated / peer)},
        'ours_from_scratch': {'envpool_ppo': pytest.approx(alone / peer)}}
    assert 'times as long as PPO on EnvPool' in text
    assert (tmp_path / 'out_lunar_lander.png').stat().st_size > 10_000
