# SPDX-License-Identifier: Apache-2.0
"""How nodes start: they are discovered during their imports, or refused."""
from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.processes import Processes
from support.processes import wait_until

SLOW = """
import pathlib, sys, time
from rocket_sim_node.wire.node.running import run_late

def load():
    print('loading', flush=True)
    while not pathlib.Path(sys.argv[1]).exists():
        time.sleep(0.01)
    if 'fails' in sys.argv[1]:
        raise ValueError('nothing to do')
    def body(node, executor):
        raise KeyError('what was asked for')
    return body, (KeyError,)

sys.exit(run_late('slow', load, args=[]))
"""


def test_a_node_is_discovered_before_its_imports_are_done(
        processes: Processes, make_node: Callable[..., Any], tmp_path: Path) -> None:
    node, _ = make_node()
    go = tmp_path / 'go'
    process = processes.start(sys.executable, '-c', SLOW, str(go))
    process.wait_for('loading', 30.0)
    wait_until(lambda: 'slow' in node.get_node_names(), 10.0)
    assert process.running
    go.touch()
    assert process.wait(10.0) == 2
    assert "[slow]: 'what was asked for'" in process.output()
    assert 'Traceback' not in process.output()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_during_the_imports_ends_the_node(
        processes: Processes, tmp_path: Path, number: signal.Signals) -> None:
    process = processes.start(sys.executable, '-c', SLOW, str(tmp_path / 'go'))
    process.wait_for('loading', 30.0)
    process.signal(number)
    assert process.wait(10.0) == 0
    assert 'Traceback' not in process.output()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_during_the_import_of_its_module_ends_a_program(
        processes: Processes, tmp_path: Path, number: signal.Signals) -> None:
    (tmp_path / 'slow_module.py').write_text('print("loading", flush=True)\nimport time\n'
                                             'time.sleep(60)\n')
    process = processes.start(
        sys.executable, '-c', f'import sys; sys.path.insert(0, {str(tmp_path)!r})\n'
        'from rocket_sim_node.entry_points import run\nrun("slow_module")')
    process.wait_for('loading', 30.0)
    process.signal(number)
    assert process.wait(10.0) == 0
    assert 'Traceback' not in process.output()


def test_an_import_that_fails_ends_the_node(processes: Processes, tmp_path: Path) -> None:
    go = tmp_path / 'fails'
    go.touch()
    process = processes.start(sys.executable, '-c', SLOW, str(go))
    assert process.wait(30.0) == 1
    assert 'ValueError: nothing to do' in process.output()


@pytest.mark.parametrize(('module', 'library'), [
    ('rocket_sim_node.nodes.simulator', 'pymunk'),
    ('ppo_agent_node.nodes.ppo_agent', 'torch'),
    ('ppo_agent_node.nodes.watch', 'torch')])
def test_slow_libraries_are_not_imported_with_the_module(
        processes: Processes, module: str, library: str) -> None:
    program = f'import sys, {module}; sys.exit({library!r} in sys.modules)'
    assert processes.start(sys.executable, '-c', program).wait(30.0) == 0


def test_invalid_ros_arguments_are_named_without_a_traceback(processes: Processes) -> None:
    process = processes.start(
        sys.executable, '-m', 'rocket_sim_node.nodes.simulator', '--ros-args', '-p', 'foo')
    assert process.wait(30.0) == 2
    assert 'Traceback' not in process.output()
    assert 'foo' in process.output()


@pytest.mark.parametrize(('executable', 'parameters', 'complaint'), [
    ('simulator', {'spwan_speed': 3}, "unknown parameter 'spwan_speed'"),
    ('simulator', {'dt': 'abc'}, "dt: got 'abc', expected a number"),
    ('ppo_agent', {'mode': 'dream'}, "mode: got 'dream', expected one of train, infer"),
    ('ppo_agent', {'clip_rang': 0.1}, "unknown parameter 'clip_rang'"),
    ('ppo_agent', {'preset': 'best'}, 'preset'),
    ('ppo_agent', {'run_dir': '/proc/run'}, '/proc/run: not writable'),
    ('ppo_agent', {'patience': 0.5}, 'is it running'),
    ('rerun_recorder', {'output': '/proc/run.rrd'}, '/proc/run'),
    ('rerun_recorder', {'connect': 'localhost'}, "connect: got 'localhost'"),
    ('rerun_recorder', {'serve_web': True, 'web_host': 'mars'}, "web_host: got 'mars'"),
    ('bag_recorder', {'topics': '"no: name"'}, 'topics: got'),
    ('bag_recorder', {'compression': 'zip'}, "compression: got 'zip'"),
    ('ros_bridge', {'rows': '[-1]'}, 'rows: got -1'),
    ('ros_bridge', {'rate': 5.0}, "unknown parameter 'rate'"),
])
def test_wrong_parameters_are_named(
        processes: Processes, tmp_path: Path, executable: str, parameters: dict[str, object],
        complaint: str) -> None:
    # A forked agent has imported PyTorch already; other tests here are about imports.
    package, start = (
        ('ppo_agent_node', processes.fork_node) if executable == 'ppo_agent' else
        ('rocket_sim_node', processes.run_node))
    folders = {'ppo_agent': 'run_dir', 'bag_recorder': 'output'}
    if executable in folders:
        parameters = {folders[executable]: tmp_path / 'made', **parameters}
    node = start(package, executable, **parameters)
    assert node.wait(30.0) == 2, node.output()
    assert complaint in node.output()
    assert 'Traceback' not in node.output()
