# SPDX-License-Identifier: Apache-2.0
"""Vendored packages are built where ROS 2 lacks them, and hide none that it has."""
from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
BOTH = ['simulation_interfaces', 'tf2_msgs']


def vendored(mode: str, prefix: Path) -> list[str]:
    """Return what set-up would build."""
    done = subprocess.run(
        ['bash', '-euc', f'. {ROOT}/launch_scripts/setup_steps.sh; vendored'],
        env={'PATH': '/usr/bin:/bin', 'root': str(ROOT), 'mode': mode,
             'AMENT_PREFIX_PATH': f'{ROOT}/ros_ws/install/tf2_msgs:{prefix}'},
        stdout=subprocess.PIPE, text=True, check=True, timeout=20)
    return done.stdout.split()


@pytest.mark.parametrize(('mode', 'there', 'expected'), [
    ('wheels', True, BOTH), ('wheels:jazzy', False, BOTH), ('sourced:kilted', False, BOTH),
    ('sourced:kilted', True, ['simulation_interfaces'])])
def test_tf2_msgs(tmp_path: Path, mode: str, there: bool, expected: list[str]) -> None:
    if there:
        share = tmp_path / 'share' / 'tf2_msgs'
        share.mkdir(parents=True)
        (share / 'package.xml').touch()
    assert vendored(mode, tmp_path) == expected


def test_colcon_does_not_find_vendored_packages_by_itself() -> None:
    """A workspace with this project in it keeps the packages of its ROS 2."""
    assert (ROOT / 'ros_ws' / 'vendor' / 'COLCON_IGNORE').is_file()
