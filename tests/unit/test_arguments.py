# SPDX-License-Identifier: Apache-2.0
"""What people give the commands of launch_scripts, and what the nodes get of it."""
from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[2] / 'launch_scripts'
PROGRAM = """
. "$1/arguments.sh"
parse_arguments "$1/land.launch.yaml" "${@:2}"
absolute output
known_arguments | sort
"""


@pytest.mark.parametrize(('given', 'got'), [
    ('output:=~/flight.rrd', 'output:=/home/me/flight.rrd'), ('output:=/a/b.rrd', None),
    ('output:=b.rrd', f'output:={SCRIPTS}/b.rrd'), ('output:=~b.rrd', f'output:={SCRIPTS}/~b.rrd'),
    ('serve_web:=True', 'serve_web:=true'), ('serve_web:=false', None),
    ('namespace:=x', 'namespace:=/x'), ('namespace:=/x/y', None), ('namespace:=', None)])
def test_arguments_mean_what_people_expect(given: str, got: str | None) -> None:
    done = subprocess.run(
        ['bash', '-euc', PROGRAM, 'land', str(SCRIPTS), given], cwd=SCRIPTS, text=True,
        env={'HOME': '/home/me', 'PATH': '/usr/bin:/bin'}, capture_output=True, timeout=20)
    assert (done.stdout.strip(), done.stderr) == (got or given, '')
