# SPDX-License-Identifier: Apache-2.0
"""The packages in a workspace that is not ours, after a plain `colcon build`."""
from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.processes import Processes

ROOT = Path(__file__).parents[3]
MESSAGES = 'rocket_msgs'
PACKAGES = ('rocket_sim_node', 'ppo_agent_node')


@pytest.fixture(scope='module')
def workspace(tmp_path_factory: pytest.TempPathFactory, nightly: bool) -> Path:
    """Copies of the packages, built over the messages that are there already.

    The messages take minutes to compile: only a nightly run copies and builds them as well.
    """
    folder = tmp_path_factory.mktemp('workspace')
    for package in (*((MESSAGES,) if nightly else ()), *PACKAGES):
        shutil.copytree(
            ROOT / package, folder / 'src' / package, symlinks=True,
            ignore=shutil.ignore_patterns('__pycache__', '*.egg-info'))
    colcon(folder, 'build')
    return folder


def environment(folder: Path) -> dict[str, str]:
    """Return the environment in which these packages come before ours."""
    prefixes = [str(folder / 'install' / package.name) for package in (folder / 'src').iterdir()]
    libraries = [str(path) for prefix in prefixes for path in Path(prefix).glob('lib/python*/*')]
    return {
        'AMENT_PREFIX_PATH': os.pathsep.join([*prefixes, os.environ['AMENT_PREFIX_PATH']]),
        'LD_LIBRARY_PATH': os.pathsep.join([
            *(f'{prefix}/lib' for prefix in prefixes), os.environ.get('LD_LIBRARY_PATH', '')]),
        'PYTHONPATH': os.pathsep.join([*libraries, os.environ['PYTHONPATH']])}


def colcon(folder: Path, *arguments: str) -> str:
    """Run colcon in a workspace and return what it printed."""
    done = subprocess.run(
        [sys.executable, '-m', 'colcon', *arguments], cwd=folder, capture_output=True, text=True,
        timeout=900, check=False, env={**os.environ, **environment(folder)})
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture
def foreign(processes: Processes, workspace: Path, monkeypatch: pytest.MonkeyPatch,
            ) -> Iterator[Processes]:
    """Processes that find the packages of the workspace first."""
    for name, value in environment(workspace).items():
        monkeypatch.setenv(name, value)
    yield processes


@pytest.mark.timeout(1200)
def test_the_launch_files_start_from_the_share_folder(
        foreign: Processes, workspace: Path, tmp_path: Path) -> None:
    recording = tmp_path / 'landing.rrd'
    landing = foreign.start(
        'ros2', 'launch', 'ppo_agent_node', 'land.launch.yaml', 'episodes:=2', 'num_envs:=2',
        'policy:=rocket', f'output:={recording}', 'namespace:=/landing')
    simulating = foreign.start(
        'ros2', 'launch', 'rocket_sim_node', 'simulate.launch.yaml', 'num_envs:=2',
        'namespace:=/simulating')
    simulating.wait_for('waiting for an agent', 60.0)
    assert landing.wait(120.0) == 0
    assert '2 episodes: landed 2' in landing.output()
    assert recording.is_file()
    simulating.signal(signal.SIGINT)
    assert simulating.wait(20.0) == 0
    for process in (landing, simulating):
        assert str(ROOT) not in process.output()


@pytest.mark.timeout(1200)
@pytest.mark.usefixtures('nightly_only')
def test_the_messages_are_those_of_the_workspace(foreign: Processes, workspace: Path) -> None:
    done = subprocess.run(
        [sys.executable, '-c', 'from rocket_msgs import msg; print(msg.__file__); '
         'from rclpy.serialization import serialize_message; serialize_message(msg.World())'],
        capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.startswith(str(workspace / 'install' / MESSAGES))


@pytest.mark.timeout(1200)
def test_colcon_runs_the_tests_of_the_packages_and_counts_them(workspace: Path) -> None:
    colcon(workspace, 'test', '--packages-select', *PACKAGES)
    counted = colcon(workspace, 'test-result', '--verbose')
    summary = counted.strip().splitlines()[-1]
    assert ' 0 errors, 0 failures, 0 skipped' in summary, counted
    assert int(summary.split()[1]) > 20, counted
