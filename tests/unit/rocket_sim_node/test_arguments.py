# SPDX-License-Identifier: Apache-2.0
"""What people give the commands of launch_scripts, and what the nodes get of it."""
from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
import yaml

from rocket_sim_node import worlds
from rocket_sim_node.worlds.rocket import conditions

SCRIPTS = Path(__file__).parents[3] / 'launch_scripts'
PROGRAM = """
. "$1/arguments.sh"
parse_arguments "$1/evaluate.launch.yaml" "${@:2}"
absolute output
absolute_policy policy
absolute_pilots pilots
known_arguments | sort
"""


@pytest.mark.parametrize(('given', 'got'), [
    ('output:=~/flight.rrd', 'output:=/home/me/flight.rrd'), ('output:=/a/b.rrd', None),
    ('output:=b.rrd', f'output:={SCRIPTS}/b.rrd'), ('output:=~b.rrd', f'output:={SCRIPTS}/~b.rrd'),
    ('seed:=True', 'seed:=true'), ('seed:=false', None),
    ('namespace:=x', 'namespace:=/x'), ('namespace:=/x/y', None),
    ('namespace:=', ''), ('policy:=', ''), ('policy:=robust', None),
    ('policy:=evaluate', f'policy:={SCRIPTS}/evaluate'), ('policy:=/a/b,c.x', None),
    ('policy:=a,b.safetensors', f'policy:={SCRIPTS}/a,b.safetensors'),
    ('pilots:=robust,expert', None), ('pilots:=', ''), ('pilots:=expert,', 'pilots:=expert'),
    ('pilots:=robust,runs/a/p.safetensors,~/b,/c',
     f'pilots:=robust,{SCRIPTS}/runs/a/p.safetensors,/home/me/b,/c')])
def test_arguments_mean_what_people_expect(given: str, got: str | None) -> None:
    done = subprocess.run(
        ['bash', '-euc', PROGRAM, 'land', str(SCRIPTS), given], cwd=SCRIPTS, text=True,
        env={'HOME': '/home/me', 'PATH': '/usr/bin:/bin'}, capture_output=True, timeout=20)
    assert (done.stdout.strip(), done.stderr) == (given if got is None else got, '')


@pytest.mark.parametrize(('text', 'value'), [
    ('', ''), ('5', 5), ('-2.5', -2.5), ('true', True), ('[64, 64]', [64, 64]), ('auto', 'auto'),
    ('a: b', 'a: b'), ('a #b', 'a #b'), ('ends:', 'ends:'), ('*x', '*x'), ("it's: x", "it's: x"),
    ('/a/b.yaml', '/a/b.yaml'), ('- x', '- x'), ('{a', '{a'), ('~/x', '~/x'), ('!x', '!x'),
    ('@x', '@x'), ('`x', '`x'), ('|', '|'), ('>', '>'), ('%x', '%x'), (']', ']'), (',', ',')])
def test_a_value_stays_what_it_is_in_a_file(text: str, value: object) -> None:
    done = subprocess.run(
        ['bash', '-euc', '. "$1/arguments.sh"; yaml_value "$2"', 'land', str(SCRIPTS), text],
        text=True, capture_output=True, timeout=20)
    assert (yaml.safe_load(f'x: {done.stdout}\n'), done.stderr) == ({'x': value}, '')


@pytest.mark.parametrize(('given', 'seen'), [
    (['world:=rocket_planar'], 'extended'), ([], 'extended'), (['world:=lunar_lander'], ''),
    (['observation:=standard'], 'standard')])
def test_rockets_are_seen_with_the_extended_observation(given: list[str], seen: str) -> None:
    program = """
    . "$1/arguments.sh"
    parse_arguments "$1/evaluate.launch.yaml" "${@:2}"
    see_extended
    known_arguments | sed -n 's/^observation:=//p'
    """
    done = subprocess.run(
        ['bash', '-euc', program, 'land', str(SCRIPTS), *given], text=True, capture_output=True,
        timeout=20)
    assert (done.stdout.strip(), done.stderr) == (seen, '')


@pytest.mark.parametrize('command', ['train', 'evaluate', 'land', 'fly'])
def test_help_names_each_argument_with_its_default(command: str) -> None:
    told = subprocess.run(
        [SCRIPTS / command, '--help'], text=True, capture_output=True, timeout=20)
    assert (told.returncode, told.stderr) == (0, '')
    launch = yaml.safe_load((SCRIPTS / f'{command}.launch.yaml').read_text())['launch']
    arguments = [entry['arg'] for entry in launch if 'arg' in entry]
    lines = [line for line in told.stdout.split('Arguments:\n')[1].splitlines() if line][
        :len(arguments)]
    for argument, line in zip(arguments, lines, strict=True):
        default = f' [{argument["default"]}]' if argument.get('default') else ''
        assert line == f'  {argument["name"]:<22} {argument["description"]}{default}'


@pytest.mark.parametrize(('command', 'given', 'message'), [
    *((command, ['conditions:=foo'], "conditions: got 'foo', expected one of nominal, mix, harsh")
      for command in ('train', 'evaluate', 'land', 'fly')),
    ('train', ['conditions:=all'], "conditions: got 'all', expected one of nominal, mix"),
    ('land', ['world:=mars'], "world: got 'mars', expected one of rocket, rocket_planar, lunar"),
    ('train', ["conditions:=it's"], "conditions: got 'it's', expected one of"),
    ('evaluate', ['conditions:=mix harsh'], "conditions: got 'mix harsh', expected one of"),
    ('evaluate', ['world:=lunar_lander', 'conditions:=all'],
     "conditions: got 'all', expected none, as world 'lunar_lander' has no conditions")])
def test_names_that_there_are_not_are_refused_before_anything_starts(
        command: str, given: list[str], message: str) -> None:
    done = subprocess.run(
        [SCRIPTS / command, *given], text=True, capture_output=True, timeout=20)
    assert (done.returncode, done.stdout) == (2, '')
    assert done.stderr.startswith(f'{command}: {message}') and done.stderr.count('\n') == 1


def test_the_scripts_know_all_worlds_and_conditions() -> None:
    text = (SCRIPTS / 'arguments.sh').read_text()
    assert f'  one_of world {" ".join(worlds.names())}\n' in text
    assert f'  one_of conditions {" ".join(conditions.NAMES)} "$@"\n' in text
