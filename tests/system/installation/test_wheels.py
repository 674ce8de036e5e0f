# SPDX-License-Identifier: Apache-2.0
"""Wheels of the packages work in a clean environment without ROS; `test --nightly` runs this."""
from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
USER = ROOT / 'tests' / 'support' / 'users' / 'wheel_user.py'
PACKAGES = ('rocket_sim_node', 'ppo_agent_node')
_KEPT = ('PIP_', 'SSL_', 'REQUESTS_', 'HTTP_PROXY', 'HTTPS_PROXY', 'NO_PROXY')
"""Beginnings of what decides how pip reaches its index."""
_SECONDS = 900
FLY_ONNX = """
import importlib.util
import sys
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.policy import PolicyPilot
from rocket_sim_node import worlds
assert importlib.util.find_spec('torch') is None
world = worlds.make('rocket', num_envs=8, level=7)
assert evaluate(world, PolicyPilot(sys.argv[1], world.spec), episodes=8, seed=1).landed.all()
"""
MISUSE = """
from rocket_sim_node import worlds
world = worlds.make(3)
world.reset(seed='one')
"""


class Environment:
    """A virtual environment that sees nothing of the project and nothing of ROS."""

    def __init__(self, folder: Path, constraints: Path) -> None:
        """Make it with the Python that made this one."""
        self._folder, self._constraints = folder, constraints
        self._env = {
            'HOME': str(folder.parent), 'PATH': '/usr/bin:/bin',
            **{name: value for name, value in os.environ.items()
               if name.upper().startswith(_KEPT)}}
        self._run(str(Path(sys.base_prefix) / 'bin' / 'python3'), '-m', 'venv', str(folder))

    def python(self, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
        """Run its Python."""
        return self._run(str(self._folder / 'bin' / 'python'), *map(str, arguments))

    def install(self, *arguments: str | Path) -> None:
        """Install packages, in the versions of the lock."""
        done = self.python('-m', 'pip', 'install', '--quiet', '-c', self._constraints, *arguments)
        assert done.returncode == 0, done.stderr

    def _run(self, *command: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            command, env=self._env, cwd=self._folder.parent, capture_output=True, text=True,
            check=False, timeout=_SECONDS)


@pytest.fixture(scope='module')
def folder(
    nightly_only: None, tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Path]:
    """A folder with `constraints.txt` and the wheels in `dist`, built by `python -m build`."""
    made = tmp_path_factory.mktemp('wheels')
    lines = (ROOT / 'launch_scripts' / 'requirements.lock').read_text().splitlines()
    constraints = made / 'constraints.txt'
    constraints.write_text('\n'.join(line for line in lines if not line.startswith('#')))
    builder = Environment(made / 'builder', constraints)
    done = builder.python('-m', 'pip', 'install', '--quiet', 'build')
    if done.returncode:
        pytest.skip(f'pip finds no index to install from: {done.stderr[-200:]}')
    for package in PACKAGES:
        # A build leaves files beside the sources.
        source = shutil.copytree(ROOT / package, made / 'src' / package)
        done = builder.python('-m', 'build', '--wheel', '--outdir', made / 'dist', source)
        assert done.returncode == 0, done.stdout + done.stderr
    yield made
    shutil.rmtree(made)  # gigabytes


@pytest.fixture(scope='module')
def clean(folder: Path) -> Environment:
    """An environment with both wheels, what they require, and mypy."""
    made = Environment(folder / 'clean', folder / 'constraints.txt')
    made.install('mypy', *sorted((folder / 'dist').glob('*.whl')))
    return made


def test_each_package_has_one_pure_python_wheel(folder: Path) -> None:
    names = [path.name for path in (folder / 'dist').iterdir()]
    assert sorted(name.split('-')[0] for name in names) == sorted(PACKAGES)
    assert all(name.endswith('-py3-none-any.whl') for name in names)


def test_worlds_adapters_training_evaluation_and_recording_work(
        folder: Path, clean: Environment) -> None:
    work = folder / 'work'
    work.mkdir()
    done = clean.python(USER, work)
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'comparison:' in done.stdout
    assert (work / 'run' / 'policy.safetensors').is_file()


def test_a_program_that_needs_ros_reports_it_in_one_line(clean: Environment) -> None:
    done = clean.python('-c', 'from rocket_sim_node.entry_points import simulator; simulator()')
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith("simulator: module 'rclpy' is missing; nodes need ROS 2")
    assert done.stderr.count('\n') == 1


def test_a_users_script_type_checks(folder: Path, clean: Environment) -> None:
    """Strictly; and types are there, since a wrong call is found."""
    script = shutil.copy(USER, folder / 'user.py')
    done = clean.python('-m', 'mypy', '--strict', script)
    assert done.returncode == 0, done.stdout
    wrong = folder / 'misuse.py'
    wrong.write_text(MISUSE)
    done = clean.python('-m', 'mypy', '--strict', wrong)
    assert done.returncode == 1, done.stdout
    assert 'Found 2 errors' in done.stdout, done.stdout


def test_an_onnx_file_flies_where_torch_is_not_installed(folder: Path) -> None:
    pytest.importorskip('onnxscript')
    from ppo_agent_node.exporting.policy_export import export
    from ppo_agent_node.pilots.search import find_policy
    policy = export(find_policy('rocket', 'rocket'), folder / 'rocket.onnx').path
    bare = Environment(folder / 'bare', folder / 'constraints.txt')
    simulator, agent = (next((folder / 'dist').glob(f'{name}-*.whl')) for name in PACKAGES)
    bare.install(simulator, 'onnxruntime', 'pyyaml', 'scipy')
    bare.install('--no-deps', agent)
    done = bare.python('-c', FLY_ONNX, policy)
    assert done.returncode == 0, done.stderr
