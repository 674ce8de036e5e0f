# SPDX-License-Identifier: Apache-2.0
"""Set-up: which steps it runs, and its messages when something is missing.

A stand-in for Python notes how it is called, so that nothing is downloaded or compiled here.
"""
from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

_ROOT = Path(__file__).parents[3]
_TOOLS = (
    'awk', 'basename', 'bash', 'cat', 'cc', 'chmod', 'c++', 'cp', 'cut', 'date', 'df', 'dirname',
    'env', 'find', 'flock', 'g++', 'gcc', 'getconf', 'grep', 'head', 'id', 'mkdir', 'mv', 'ps',
    'rm', 'sed', 'setsid', 'sh', 'sha256sum', 'sleep', 'sort', 'stty', 'tail', 'touch', 'tr',
    'uname', 'xargs')
_PYTHON = r"""#!/usr/bin/env bash
echo "$*" >> "$CALLS"
case "$*" in
  *'sys.implementation'*) exit "${PYTHON_FITS:-0}" ;;
  *get_path*) echo "$INCLUDE" ;;
  *-dev* | *-venv*) echo python3.11-dev ;;
  -V | -VV) echo 'Python 3.11.9' ;;
  '-m venv'*)
    if [[ -n ${VENV_FAILS:-} ]]; then echo "$VENV_FAILS"; exit 1; fi
    mkdir -p "${@: -1}/bin"
    cp "$0" "${@: -1}/bin/python"
    echo "VIRTUAL_ENV='${@: -1}'; export VIRTUAL_ENV" > "${@: -1}/bin/activate" ;;
  *'pip'*' install '*'stamps'* | *'pip'*' install '*requirements)
    sleep "${PIP_SECONDS:-0}"
    if [[ -n ${PIP_KILLS:-} ]]; then kill -9 "$PPID"; fi
    if [[ -n ${PIP_FAILS:-} ]]; then echo "$PIP_FAILS"; exit 1; fi ;;
  *'-m colcon'*)
    if [[ -n ${COLCON_FAILS:-} ]]; then echo "$COLCON_FAILS"; exit 1; fi
    while [[ $1 != --install-base ]]; do shift; done
    mkdir -p "$2"
    echo "export AMENT_PREFIX_PATH=$2/rocket_msgs" > "$2/local_setup.bash" ;;
esac
"""


class Project:
    """A copy of what set-up needs, with tools of its own."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / 'project'
        self.tools = folder / 'tools'
        self.calls_file = folder / 'calls'
        include = folder / 'include'
        for path in (self.root / 'ros_ws', self.tools, include):
            path.mkdir(parents=True)
        (include / 'Python.h').touch()
        self.env = {
            'PATH': str(self.tools), 'HOME': str(folder), 'CALLS': str(self.calls_file),
            'INCLUDE': str(include)}
        shutil.copytree(_ROOT / 'launch_scripts', self.root / 'launch_scripts')
        for package in ('rocket_msgs', 'rocket_sim_node', 'ppo_agent_node'):
            shutil.copytree(_ROOT / package, self.root / package)
        shutil.copytree(_ROOT / 'ros_ws/vendor', self.root / 'ros_ws/vendor')
        for name in _TOOLS:
            path = shutil.which(name)
            if path is not None:
                (self.tools / name).symlink_to(path)
        self.tool('python3.11', _PYTHON)

    def tool(self, name: str, text: str) -> None:
        """Put a script in the place of a tool."""
        path = self.tools / name
        path.unlink(missing_ok=True)
        path.write_text(text)
        path.chmod(0o755)

    def start(self, command: str = 'launch_scripts/setup', **env: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [str(self.tools / 'bash'), '-c', command], cwd=self.root, env={**self.env, **env},
            text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True)

    def run(self, command: str = 'launch_scripts/setup', **env: str) -> tuple[int, str]:
        """Run a command; returns its status and what it printed."""
        process = self.start(command, **env)
        output, _ = process.communicate(timeout=60)
        return process.returncode, output

    def pin(self, package: str) -> None:
        """Want one package more."""
        lock = self.root / 'launch_scripts/requirements.lock'
        lock.write_text(lock.read_text().replace('# --- run', f'{package}\n# --- run', 1))

    def calls(self) -> list[str]:
        """Return what Python was asked to install, make or build since the last time."""
        lines = self.calls_file.read_text().splitlines() if self.calls_file.exists() else []
        self.calls_file.unlink(missing_ok=True)
        names = {'-m venv': 'venv', ' install ': 'pip', 'rocket_msgs': 'messages',
                 'symlink-install': 'nodes'}
        return [name for line in lines for key, name in names.items() if key in line]


@pytest.fixture
def project(tmp_path: Path) -> Project:
    return Project(tmp_path)


_ALL = ['venv', 'pip', 'pip', 'messages', 'nodes']


def test_only_outdated_steps_run_again(project: Project) -> None:
    status, output = project.run()
    assert status == 0, output
    assert project.calls() == _ALL
    status, output = project.run()
    assert (status, output, project.calls()) == (0, 'Everything is set up.\n', [])
    for streams in ('', '2>&-', '>&-', '<&- >&- 2>&-'):
        assert project.run(f'launch_scripts/setup --quiet {streams}') == (0, '')
    assert project.run('launch_scripts/setup 2>&-') == (0, '')

    (project.root / 'rocket_sim_node/rocket_sim_node/new.py').write_text('x = 1\n')
    project.run()
    assert project.calls() == [], 'nodes are linked to their sources'
    (project.root / 'rocket_msgs/msg/New.msg').write_text('bool x\n')
    project.run()
    assert project.calls() == ['messages']
    (project.root / 'rocket_sim_node/setup.py').write_text('x = 1\n')
    project.run()
    assert project.calls() == ['nodes']

    lock = project.root / 'launch_scripts/requirements.lock'
    lock.write_text(lock.read_text().replace('rich==', 'rich==1.'))
    project.run()
    assert project.calls() == ['pip', 'pip']
    lock.write_text(lock.read_text().replace('ros-rclpy==', 'ros-rclpy==1.'))
    project.run()
    assert project.calls() == ['pip', 'pip', 'messages', 'nodes']

    shutil.rmtree(project.root / 'ros_ws/install')
    project.run()
    assert project.calls() == ['messages', 'nodes']
    project.tool('python3.12', _PYTHON)
    project.run(PYTHON='python3.12')
    assert project.calls() == _ALL


def test_distributions_live_side_by_side(project: Project) -> None:
    project.run()
    assert project.calls() == _ALL
    status, output = project.run(HOVERSLAM_ROS='jazzy')
    assert (status, project.calls()) == (0, _ALL), output
    for name, wanted in (('.venv', 'ros-rclpy==9.'), ('.venv-jazzy', 'ros-rclpy==7.')):
        pins = (project.root / name / '.hoverslam/requirements').read_text().splitlines()
        assert sum(pin.startswith('ros-rclpy==') for pin in pins) == 1
        assert any(pin.startswith(wanted) for pin in pins), name
        assert any(pin.startswith('rerun-sdk==') for pin in pins), 'what is not ROS is the same'
    for name in ('kilted', 'jazzy', ''):
        assert project.run(HOVERSLAM_ROS=name) == (0, 'Everything is set up.\n')
    lock = project.root / 'launch_scripts/requirements-jazzy.lock'
    lock.write_text(lock.read_text().replace('ros-rclpy==', 'ros-rclpy==1.'))
    assert project.run() == (0, 'Everything is set up.\n')
    project.run(HOVERSLAM_ROS='jazzy')
    assert project.calls() == ['pip', 'pip', 'messages', 'nodes']


def test_a_shell_can_switch_between_distributions(project: Project) -> None:
    tell = ('; echo "$VIRTUAL_ENV $PATH $AMENT_PREFIX_PATH $LD_LIBRARY_PATH '
            '$ROS_DISTRO $HOVERSLAM_WHEELS"')
    status, output = project.run(
        f'. launch_scripts/env.sh{tell}; LD_LIBRARY_PATH=$VIRTUAL_ENV/lib:/mine; '
        f'export HOVERSLAM_ROS=jazzy; . launch_scripts/env.sh{tell}', LD_LIBRARY_PATH='/mine')
    assert status == 0, output
    kilted, jazzy = (line for line in output.splitlines() if line.startswith('/'))
    root = project.root
    assert kilted == (
        f'{root}/.venv {root}/.venv/bin:{project.tools} '
        f'{root}/ros_ws/install/rocket_msgs:{root}/.venv /mine kilted kilted')
    assert jazzy == (
        f'{root}/.venv-jazzy {root}/.venv-jazzy/bin:{project.tools} '
        f'{root}/ros_ws/jazzy/install/rocket_msgs:{root}/.venv-jazzy /mine jazzy jazzy')


@pytest.mark.parametrize('command', [
    'launch_scripts/setup', '. launch_scripts/env.sh', 'launch_scripts/land',
    'launch_scripts/test'])
def test_an_unsupported_distribution_is_named(command: str, project: Project) -> None:
    assert project.run(command, HOVERSLAM_ROS='foxy') == (
        2, "setup: HOVERSLAM_ROS is 'foxy', expected kilted or jazzy, or a ROS 2 of that name "
        'that is sourced\n')
    assert project.calls() == []


@pytest.mark.parametrize('named', [{}, {'HOVERSLAM_ROS': 'lyrical'}])
def test_a_sourced_ros_2_of_another_version_is_used(
        named: dict[str, str], project: Project) -> None:
    """NumPy comes from the lock file: rerun-sdk does not run with that of Ubuntu 24.04."""
    sourced = {'ROS_DISTRO': 'lyrical', 'AMENT_PREFIX_PATH': '/opt/ros/lyrical', **named}
    status, output = project.run(**sourced)
    assert status == 0, output
    assert output.count('Note: ROS 2 lyrical has not been tested') == 1
    pins = (project.root / '.venv/.hoverslam/requirements').read_text()
    lock = (project.root / 'launch_scripts/requirements.lock').read_text()
    (numpy,) = (line for line in lock.splitlines() if line.startswith('numpy=='))
    assert f'\n{numpy}\n' in pins
    assert 'ros-rclpy' not in pins
    assert project.run(**sourced) == (0, 'Everything is set up.\n')
    assert project.run(**{**sourced, 'HOVERSLAM_ROS': 'jazzy'}) == (
        2, "setup: HOVERSLAM_ROS is 'jazzy', expected 'lyrical', which is sourced, or unset\n")


def test_a_distribution_that_env_sh_named_does_not_count_as_sourced(project: Project) -> None:
    status, output = project.run(
        ROS_DISTRO='kilted', HOVERSLAM_WHEELS='kilted', AMENT_PREFIX_PATH='/else/.venv')
    assert status == 0, output
    assert 'ros-rclpy' in (project.root / '.venv/.hoverslam/requirements').read_text()


def test_a_ros_2_sourced_in_a_shell_of_env_sh_is_used(project: Project) -> None:
    """Even if it is of the same distribution as the wheels."""
    status, output = project.run(
        '. launch_scripts/env.sh; echo "wheels ${HOVERSLAM_WHEELS-none}"', ROS_DISTRO='kilted',
        HOVERSLAM_WHEELS='kilted', ROS_VERSION='2', AMENT_PREFIX_PATH='/opt/ros/kilted')
    assert status == 0, output
    assert 'ros-rclpy' not in (project.root / '.venv/.hoverslam/requirements').read_text()
    assert output.splitlines()[-1] == 'wheels none'


def test_a_failed_update_keeps_the_environment(project: Project) -> None:
    """Without a network or with little room, the old one stays and the next update can succeed."""
    project.run()
    project.calls()
    project.pin('more==1')
    project.tool('df', '#!/bin/sh\necho; echo /dev/x 9 8 1024000 1 /\n')
    mark = project.root / '.venv/mark'
    mark.touch()
    for _ in range(2):
        status, _ = project.run(PIP_FAILS='no network')
        assert status == 1
        assert mark.exists()
    project.calls()
    status, output = project.run()
    assert status == 0, output
    assert mark.exists()
    assert 'venv' not in project.calls()


def test_a_killed_update_builds_a_new_environment(project: Project) -> None:
    """Half of a package may be installed, and look complete."""
    project.run()
    project.pin('more==1')
    assert project.run(PIP_KILLS='1')[0] == -signal.SIGKILL
    project.calls()
    assert project.run()[0] == 0
    assert project.calls() == ['venv', 'pip', 'pip']


def test_a_set_up_with_an_unusable_python_keeps_the_environment(project: Project) -> None:
    project.run()
    project.tool('python3.12', _PYTHON)
    status, output = project.run(PYTHON='python3.12', INCLUDE='/nowhere')
    assert status == 1
    assert 'Python.h' in output
    assert (project.root / '.venv/bin/python').exists()


def test_the_python_of_an_entered_shell_needs_no_new_set_up(project: Project) -> None:
    project.run(PYTHON='python3.11')
    path = project.root / '.venv/bin'
    shutil.copy(path / 'python', path / 'python3.11')
    for name in ('python3.11', str(path / 'python3.11')):
        assert project.run(PYTHON=name, PATH=f'{path}:{project.tools}') == (
            0, 'Everything is set up.\n')


def test_a_moved_project_is_set_up_again(project: Project) -> None:
    project.run()
    project.calls()
    project.root = project.root.rename(project.root.with_name('elsewhere'))
    assert project.run()[0] == 0
    assert project.calls() == _ALL


def test_a_killed_set_up_is_done_again(project: Project) -> None:
    assert project.run(PIP_KILLS='1')[0] == -signal.SIGKILL
    project.calls()
    assert project.run()[0] == 0
    assert project.calls() == _ALL


@pytest.mark.parametrize('later', [0.0, 0.2])
@pytest.mark.parametrize(('send', 'number', 'ended'), [
    (os.killpg, signal.SIGINT, 130), (os.kill, signal.SIGINT, 130), (os.kill, signal.SIGTERM, 143),
    (os.killpg, signal.SIGHUP, 143)])
def test_an_interrupted_set_up_is_reported_and_can_continue(
        project: Project, later: float, send: Callable[[int, int], None], number: int,
        ended: int) -> None:
    process = project.start('exec launch_scripts/setup', PIP_SECONDS='120')
    assert process.stdout is not None
    for line in process.stdout:
        if 'Preparing pip' in line:
            break
    time.sleep(later)
    send(process.pid, number)
    output = process.stdout.read()
    assert 'interrupted; run it again to continue' in output
    assert process.wait(10) == ended
    # No pip that holds the lock is left.
    project.calls()
    assert project.run()[0] == 0
    assert project.calls() == _ALL


def test_an_interruption_while_a_command_starts_ends_the_command(project: Project) -> None:
    script = project.root / 'launch_scripts/progress.sh'
    text = script.read_text()
    waits = '  wait "$!" || status=$?\n'
    assert text.count(waits) == 1
    signals = '  [[ $text != Installing* ]] || kill -TERM "$$"\n'
    script.write_text(text.replace(waits, signals + waits))
    process = project.start(PIP_SECONDS='120')
    output, _ = process.communicate(timeout=20)
    assert process.returncode == 143, output
    script.write_text(text)
    # No pip that holds the lock is left.
    project.calls()
    assert project.run()[0] == 0
    assert project.calls() == _ALL


def test_two_set_ups_at_once_do_the_work_once(project: Project) -> None:
    both = [project.start(PIP_SECONDS='0.3') for _ in range(2)]
    outputs = [process.communicate(timeout=60)[0] for process in both]
    assert [process.returncode for process in both] == [0, 0], outputs
    assert project.calls() == _ALL
    assert 'Waiting for another set-up' in ''.join(outputs)


@pytest.mark.parametrize(('arguments', 'said'), [
    ('--help x', "got '--help x', expected one argument at most"),
    ('--quiet x', "got '--quiet x', expected one argument at most"),
    ('--fast', "unknown argument '--fast'")])
def test_wrong_arguments_are_refused(project: Project, arguments: str, said: str) -> None:
    assert project.run(f'launch_scripts/setup {arguments}') == (
        2, f'setup: {said} (see --help)\n')


@pytest.mark.parametrize(('env', 'message', 'advice'), [
    ({'PYTHON_FITS': '1'}, 'no CPython 3.11, 3.12 or 3.13 found', 'apt install python3'),
    ({'PYTHON': '/no/python'}, 'PYTHON=/no/python is not a CPython', 'unset PYTHON'),
    ({'INCLUDE': '/nowhere'}, 'the headers (Python.h)', 'apt install python3.11-dev'),
    ({'VENV_FAILS': 'No module named venv'}, 'has no working venv module', 'apt install'),
    ({'VENV_FAILS': 'ensurepip is not available'}, 'has no working venv module', 'apt install'),
    ({'PIP_FAILS': 'OSError: [Errno 28] No space left on device'}, 'the disk is full', 'Free'),
    ({'PIP_FAILS': 'Failed to establish a new connection: [Errno -3]'},
     'the package index cannot be reached', 'Check the network'),
    ({'PIP_FAILS': 'ERROR: No matching distribution found for torch==9'},
     'No matching distribution found for torch==9', '.setup.log'),
    ({'PIP_FAILS': 'some other trouble'}, 'some other trouble', '.setup.log'),
    ({'COLCON_FAILS': 'World.msg: syntax error'}, 'World.msg: syntax error', '.setup.log'),
    ({'ROS_DISTRO': 'x', 'AMENT_PREFIX_PATH': '/opt/ros/x', 'PYTHON_FITS': '1'},
     'no CPython 3.11 or newer found whose rclpy is that of the sourced ROS 2 x', 'apt install'),
])
def test_a_failure_is_named_and_the_next_set_up_succeeds(
        env: dict[str, str], message: str, advice: str, project: Project) -> None:
    status, output = project.run(**env)
    assert status == 1
    assert message in output
    assert advice in output
    assert 'Traceback' not in output
    project.calls()
    assert project.run()[0] == 0


@pytest.mark.parametrize(('tool', 'text', 'message', 'advice'), [
    ('uname', 'case $1 in -s) echo Linux ;; -m) echo aarch64 ;; esac',
     'no ROS 2 wheels for aarch64', 'Install ROS 2 Kilted or Jazzy'),
    ('uname', 'echo Darwin', 'this is Darwin', 'WSL 2'),
    ('getconf', 'exit 1', 'need glibc', 'Debian'),
    ('df', 'echo h; echo /dev/x 100 50 500000 1% /', 'only 488 MB of disk are free', 'Free some'),
])
def test_unfit_machines_are_refused_with_advice(
        tool: str, text: str, message: str, advice: str, project: Project) -> None:
    project.tool(tool, f'#!/bin/sh\n{text}\n')
    status, output = project.run()
    assert status == 1
    assert message in output
    assert advice in output
    assert not (project.root / '.venv').exists()


@pytest.mark.parametrize('names', [('cc', 'gcc'), ('c++', 'g++')])
def test_a_missing_compiler_is_named(names: tuple[str, str], project: Project) -> None:
    for name in names:
        (project.tools / name).unlink(missing_ok=True)
    status, output = project.run()
    assert status == 1
    assert f'no {names[1]} found' in output
    assert 'build-essential' in output


def test_a_path_with_a_space_is_refused(project: Project) -> None:
    project.root = project.root.rename(project.root.with_name('a b'))
    status, output = project.run()
    assert status == 1
    assert 'has a space, a colon' in output


@pytest.mark.skipif(os.geteuid() == 0, reason='root may write everywhere')
def test_a_read_only_folder_is_refused(project: Project) -> None:
    project.root.chmod(0o555)
    status, output = project.run()
    project.root.chmod(0o755)
    assert status == 1
    assert 'is not writable for' in output


def test_env_sh_enters_once_and_removes_foreign_environments(project: Project) -> None:
    status, output = project.run(
        '. launch_scripts/env.sh; one=$PATH$AMENT_PREFIX_PATH; . launch_scripts/env.sh; '
        '[[ $one == "$PATH$AMENT_PREFIX_PATH" ]] || echo grown; '
        'echo "$VIRTUAL_ENV ${PYTHONPATH-none} ${PYTHONHOME-none} '
        '${_ROS_WHEELS_BOOTSTRAP_COMPLETE-none} $ROS_AUTOMATIC_DISCOVERY_RANGE"; '
        'echo "$PATH $AMENT_PREFIX_PATH"; set | grep -c ^_hoverslam || true',
        VIRTUAL_ENV='/foreign', PYTHONPATH='/foreign/site-packages', PYTHONHOME='/foreign',
        _ROS_WHEELS_BOOTSTRAP_COMPLETE='1')
    assert status == 0, output
    venv = project.root / '.venv'
    assert output.splitlines()[-3:] == [
        f'{venv} none none none LOCALHOST',
        f'{venv}/bin:{project.tools} {project.root}/ros_ws/install/rocket_msgs:{venv}', '0']


def test_env_sh_keeps_the_shell_when_set_up_fails(project: Project) -> None:
    status, output = project.run(
        '. launch_scripts/env.sh; echo "status $?"; echo still here', PYTHON_FITS='1')
    assert (status, output.splitlines()[-2:]) == (0, ['status 1', 'still here'])
    status, output = project.run('set -e; . launch_scripts/env.sh; echo here', PYTHON_FITS='1')
    assert status == 1
    assert 'here' not in output.splitlines()


def test_the_range_of_discovery_can_be_chosen(project: Project) -> None:
    status, output = project.run(
        '. launch_scripts/env.sh; echo $ROS_AUTOMATIC_DISCOVERY_RANGE',
        ROS_AUTOMATIC_DISCOVERY_RANGE='SUBNET')
    assert (status, output.splitlines()[-1]) == (0, 'SUBNET')
