# SPDX-License-Identifier: Apache-2.0
"""No command imports a module from the folder that it is called in."""
from __future__ import annotations

import os
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from support.processes import Processes

SCRIPTS = Path(__file__).parents[3] / 'launch_scripts'
CALLS: dict[str, tuple[str, ...]] = {
    'train': ('--help',), 'land': ('num_envs:=1', 'episodes:=1', 'output:=landing.rrd'),
    'evaluate': ('--help',), 'fly': ('--help',), 'report': ('nowhere',),
    'compare': ('run_dir:=nowhere',), 'failures': ('run_dir:=nowhere',),
    'screenshot': ('recording:=nowhere.rrd',), 'pictures': ('only:=training', 'run_dir:=nowhere'),
    'bench': ('rollouts', '--help'), 'export': ('policy:=none', 'output:=none.onnx'),
    'secure': ('true',), 'setup': ('--quiet',),
    'test': ('--collect-only', '-q', 'tests/unit/test_layers.py')}
"""arguments, by command: a cheap call that imports what the command does"""


@pytest.fixture(scope='module')
def traps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a module of every name; each module reports its import."""
    folder = tmp_path_factory.mktemp('traps')
    names = {*sys.stdlib_module_names, *packages_distributions(), 'rclpy', 'rocket_msgs'}
    for name in filter(str.isidentifier, names):
        (folder / f'{name}.py').write_text(
            f"open({str(folder / 'caught')!r}, 'a').write(__name__ + ' ')\n")
    return folder


def call(processes: Processes, traps: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a command in the folder of traps, and assert that no trap was imported."""
    env = {name: value for name, value in processes.env.items() if name != 'PYTHONSAFEPATH'}
    done = subprocess.run(
        words, cwd=traps, capture_output=True, text=True, timeout=120, check=False,
        stdin=subprocess.DEVNULL, env={**env, 'PYTHONPATH': f':{env["PYTHONPATH"]}:'})
    caught = traps / 'caught'
    imported = caught.read_text() if caught.exists() else ''
    caught.unlink(missing_ok=True)
    assert imported == '', f'{words} imports {imported}\n{done.stderr}'
    return done


def test_every_command_is_tried() -> None:
    scripts = {
        path.name for path in SCRIPTS.iterdir()
        if path.is_file() and os.access(path, os.X_OK)}
    assert CALLS.keys() == scripts


@pytest.mark.parametrize('name', CALLS)
def test_a_command_imports_nothing_from_the_folder_it_is_called_in(
        processes: Processes, traps: Path, name: str) -> None:
    done = call(processes, traps, str(SCRIPTS / name), *CALLS[name])
    assert 'Traceback' not in done.stderr + done.stdout
    assert done.returncode in (0, 2), done.stderr


def test_ros2_in_the_environment_imports_nothing_from_the_folder(
        processes: Processes, traps: Path) -> None:
    enter = f'. {SCRIPTS}/env.sh && '
    for words in ('ros2 pkg list', 'ros2 topic list', 'ros2 run ppo_agent_node ppo_agent x'):
        call(processes, traps, 'bash', '-c', enter + words)


def test_user_programs_import_the_modules_beside_them(
        processes: Processes, tmp_path: Path) -> None:
    (tmp_path / 'beside.py').write_text("print('found')")
    (tmp_path / 'mine.py').write_text('import beside')
    env = {name: value for name, value in processes.env.items() if name != 'PYTHONSAFEPATH'}
    done = subprocess.run(
        ['bash', '-c', f'. {SCRIPTS}/env.sh && python {tmp_path}/mine.py'], env=env,
        capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == 'found\n'
