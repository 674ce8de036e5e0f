# SPDX-License-Identifier: Apache-2.0
"""`launch_scripts/secure` with stand-ins for the commands of a ROS 2 with DDS-Security."""
from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[3] / 'launch_scripts'
STAND_INS = {
    'python': 'exit 0',
    'ros2': """
[[ $* == *--help* ]] && exit
echo "$*" >> "$CALLS"
[[ -e $BROKEN ]] && { mkdir -p "$4/private" "$4/enclaves"; exit 3; }
mkdir -p "$4/private" "$4/enclaves"
""",
    'command': """
printf '%s|' "$@" "$ROS_SECURITY_ENABLE" "$ROS_SECURITY_STRATEGY" "$ROS_SECURITY_KEYSTORE" \\
  "${ROS_SECURITY_ENCLAVE_OVERRIDE-none}" "$HOVERSLAM_SECURE"
exit 7
""",
}
Secure = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def secure(tmp_path: Path) -> Secure:
    """Run the script of a copy of its folder, whose environment has the stand-ins."""
    scripts, tools = tmp_path / 'scripts', tmp_path / 'tools'
    scripts.mkdir()
    tools.mkdir()
    for name in ('secure', 'streams.sh'):
        shutil.copy(SCRIPTS / name, scripts)
    shutil.copytree(SCRIPTS / 'security', scripts / 'security')
    (scripts / 'env.sh').write_text(f'PATH={tools}:$PATH\n')
    for name, text in STAND_INS.items():
        for folder in (tools, scripts) if name == 'command' else (tools,):
            (folder / name).write_text(f'#!/usr/bin/env bash\n{text}')
            (folder / name).chmod(0o755)

    def run(*arguments: str, **more: str) -> subprocess.CompletedProcess[str]:
        env = {name: value for name, value in os.environ.items() if not name.startswith('ROS_')}
        return subprocess.run(
            [scripts / 'secure', *arguments], capture_output=True, text=True, timeout=30,
            check=False, env={
                **env, 'CALLS': str(tmp_path / 'calls'), 'BROKEN': str(tmp_path / 'broken'),
                'ROS_DOMAIN_ID': '42', **more})

    return run


def calls(tmp_path: Path) -> list[str]:
    """Return how `ros2` was called."""
    made = tmp_path / 'calls'
    return made.read_text().splitlines() if made.exists() else []


def test_a_command_starts_with_keys_that_are_made_once(tmp_path: Path, secure: Secure) -> None:
    store = tmp_path / '.keystore' / 'domain-42'
    for _ in range(2):
        done = secure('command', 'one two', '', ROS_SECURITY_ENCLAVE_OVERRIDE='/other')
        assert done.stdout.split('|')[:-1] == [
            'one two', '', 'true', 'Enforce', str(store), 'none',
            str(tmp_path / 'scripts' / 'secure')], done.stderr
        assert done.returncode == 7, 'its status is that of the command'
    policy = tmp_path / 'scripts' / 'security' / 'hoverslam.policy.xml'
    assert calls(tmp_path) == [f'security generate_artifacts -k {store} -p {policy}']
    assert store.stat().st_mode & 0o077 == 0, 'other users cannot read the keys'


def test_keys_are_renewed_for_another_policy_and_after_a_failure(
        tmp_path: Path, secure: Secure) -> None:
    broken = tmp_path / 'broken'
    broken.touch()
    done = secure('command')
    assert (done.returncode, done.stdout) == (3, ''), 'nothing starts without keys'
    broken.unlink()
    assert secure('command').returncode == 7
    assert len(calls(tmp_path)) == 2
    made = tmp_path / '.keystore' / 'domain-42' / '.made'
    os.utime(made, (1, 1))  # as if the policy were newer
    assert secure('command').returncode == 7
    assert secure('command').returncode == 7
    assert len(calls(tmp_path)) == 3


def test_copied_keys_are_used_as_they_are(tmp_path: Path, secure: Secure) -> None:
    store = tmp_path / 'copied'
    (store / 'enclaves').mkdir(parents=True)
    done = secure('command', ROS_SECURITY_KEYSTORE=str(store))
    assert done.returncode == 7
    assert str(store) in done.stdout
    assert calls(tmp_path) == []


@pytest.mark.parametrize(('name', 'text', 'said'), [
    ('python', 'exit 2', 'nothing was started'),
    ('ros2', 'exit 1', "no command 'ros2 security': install ros-")])
def test_nothing_starts_without_dds_security_or_its_command(
        tmp_path: Path, secure: Secure, name: str, text: str, said: str) -> None:
    (tmp_path / 'tools' / name).write_text(f'#!/usr/bin/env bash\n{text}\n')
    done = secure('command')
    assert (done.returncode, done.stdout) == (2, '')
    assert said in done.stderr
    assert done.stderr.count('\n') == 1
    assert not (tmp_path / '.keystore').exists()
