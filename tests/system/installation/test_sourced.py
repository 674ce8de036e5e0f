# SPDX-License-Identifier: Apache-2.0
"""Set-up, flights and tests with a sourced ROS 2, of which an imitation is made of the wheels.

It shows that nothing depends on wheels; it cannot show that packages of a distribution work.
`./launch_scripts/test --nightly` runs this.
"""
from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.machine import sourced_ros

ROOT = Path(__file__).parents[3]
KEPT = ('HOME', 'LANG', 'PIP_FIND_LINKS', 'PIP_CERT', 'SSL_CERT_FILE', 'ROS_DOMAIN_ID')
SECONDS = 1500

Run = Callable[[str], str]


@pytest.fixture(scope='module')
def sourced(
    nightly_only: None, tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Run]:
    """Yield what runs a command in a clone, in a shell in which ROS 2 is sourced."""
    folder = tmp_path_factory.mktemp('sourced')
    setup = sourced_ros.install(folder / 'ros', os.environ['ROS_DISTRO'])
    clone = folder / 'hoverslam'
    subprocess.run(['git', 'clone', '--quiet', ROOT, clone], check=True, timeout=120)
    python = Path(sys._base_executable).parent  # type: ignore[attr-defined]
    env = {'PATH': f'{python}:/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin',
           **{name: os.environ[name] for name in KEPT if name in os.environ}}

    def run(command: str) -> str:
        done = subprocess.run(
            ['bash', '-c', f'. {setup} && cd {clone} && {command}'], env=env, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False, timeout=SECONDS)
        assert done.returncode == 0, done.stdout
        return done.stdout

    yield run
    shutil.rmtree(folder)  # gigabytes


@pytest.mark.timeout(2 * SECONDS)
def test_set_up_flights_and_tests_use_the_sourced_ros_2(sourced: Run, tmp_path: Path) -> None:
    assert 'Set up in ' in sourced('./launch_scripts/setup')
    loaded = sourced('. launch_scripts/env.sh && python -c "import rclpy; print(rclpy.__file__)"')
    assert '/ros/lib/' in loaded
    landed = sourced(f'./launch_scripts/land policy:=robust episodes:=4 output:={tmp_path}/a.rrd')
    assert '4 episodes: landed 4' in landed
    assert (tmp_path / 'a.rrd').is_file()
    assert ' passed' in sourced('./launch_scripts/test --smoke')
