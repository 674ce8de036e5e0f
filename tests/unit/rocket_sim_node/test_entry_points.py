# SPDX-License-Identifier: Apache-2.0
"""Programs that pip installs where there is no ROS 2."""
from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from rocket_sim_node import entry_points

ROOT = Path(__file__).parents[3]
NO_ROS = """
import importlib
import sys
sys.modules.update(dict.fromkeys(('rclpy', 'rocket_msgs', 'rcl_interfaces')))
for program in sys.argv[1:]:
    module, _, function = program.partition(':')
    try:
        getattr(importlib.import_module(module), function)()
    except SystemExit as error:
        print(function, error.code)
"""


def programs() -> dict[str, str]:
    """Return the programs of both packages, and what each runs."""
    found: dict[str, str] = {}
    for package in ('rocket_sim_node', 'ppo_agent_node'):
        text = (ROOT / package / 'setup.py').read_text()
        scripts = text.partition("'console_scripts': [")[2].partition(']')[0]
        found |= dict(re.findall(r"'(\w+) = ([\w.:]+)'", scripts))
    return found


def test_each_program_runs_the_node_of_its_name() -> None:
    for name, target in programs().items():
        package, _, function = target.partition('.entry_points:')
        assert function == name
        assert (ROOT / package / package / 'nodes' / f'{name}.py').is_file()


@pytest.mark.slow
def test_without_ros_each_program_ends_with_a_line_and_status_2() -> None:
    found = programs()
    done = subprocess.run(
        [sys.executable, '-c', NO_ROS, *found.values()], capture_output=True, text=True,
        check=False, timeout=240)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split('\n')[:-1] == [f'{name} 2' for name in found]
    lines = done.stderr.split('\n')[:-1]
    assert len(lines) == len(found), done.stderr
    for name, line in zip(found, lines, strict=True):
        assert re.match(rf"{name}: module '(rclpy|rocket_msgs|rcl_interfaces)' is missing; "
                        r'nodes need ROS 2', line), line


@pytest.mark.parametrize(('module', 'advice'), [
    ('rerun', "pip install 'rocket_sim_node[recording]'"), ('torch', 'pip install torch')])
def test_a_module_that_pip_brings_is_named_with_the_command(
    module: str, advice: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(f'No module named {module!r}', name=f'{module}.parts')

    monkeypatch.setattr(entry_points.importlib, 'import_module', missing)
    with pytest.raises(SystemExit, match='2'):
        entry_points.rerun_recorder()
    assert capsys.readouterr().err == (
        f'rerun_recorder: module {module!r} is missing; {advice}\n')


def test_a_missing_module_of_our_own_is_a_bug_and_keeps_its_traceback() -> None:
    with pytest.raises(ModuleNotFoundError):
        entry_points.run('rocket_sim_node.nodes.no_such_node')


def test_no_file_takes_the_place_of_a_closed_stream(tmp_path: Path) -> None:
    (tmp_path / 'node.py').write_text("""
import subprocess
import sys
def main():
    sys.stdin.read()
    child = 'import os; [os.fstat(n) for n in range(3)]'
    subprocess.run([sys.executable, '-c', child], check=True)
    with open('made', 'w') as file:
        print('printed')
        sys.stderr.write('error')
        file.write(str(file.fileno() > 2))
""")
    for closed in ('<&-', '>&-', '2>&-', '<&- >&- 2>&-'):
        subprocess.run(
            ['bash', '-c', f'"$0" "$@" {closed}', sys.executable, '-c',
             'from rocket_sim_node.entry_points import run; run("node")'],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            cwd=tmp_path, check=True, timeout=60, env={
                **os.environ, 'PYTHONPATH': os.pathsep.join(
                    [str(tmp_path), os.environ.get('PYTHONPATH', '')])})
        assert (tmp_path / 'made').read_text() == 'True', closed
