# SPDX-License-Identifier: Apache-2.0
"""Arguments of train, land, evaluate and fly: checked, and sent where they belong."""
from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from ppo_agent_node.commands import arguments
from ppo_agent_node.commands.arguments import Arguments
from ppo_agent_node.config.connection_config import FleetConfig
from ppo_agent_node.nodes.agent.training import TrainingParameters
from ppo_agent_node.nodes.flights.connection import ConnectionParameters
from ppo_agent_node.nodes.keyboard_pilot import KeyboardParameters
from ppo_agent_node.pilots import choice
from rocket_sim_node import settings
from rocket_sim_node.nodes.simulation import SimulatorParameters
from rocket_sim_node.wire.dds import qos

SCRIPTS = Path(__file__).parents[4] / 'launch_scripts'
LAUNCH_FILES = SCRIPTS.parent / 'ppo_agent_node' / 'launch'


def parse(command: str, *texts: str) -> Arguments:
    return arguments.parse(command, LAUNCH_FILES / f'{command}.launch.yaml', texts)


def test_each_argument_goes_where_it_belongs() -> None:
    found = parse(
        'train', 'max_thrust:=500000', 'num_envs:=64', 'seed:=3', 'hidden_sizes:=[64,32]',
        'fine_observations:=', 'simulators:=/sim_*', 'learning_rate_decay:=False', 'connect:=')
    assert found.simulator == {'max_thrust': 500_000.0}
    assert found.launch == {'num_envs': '64'}
    assert found.agent == {
        'seed': 3, 'hidden_sizes': (64, 32), 'fine_observations': '', 'simulators': '/sim_*',
        'learning_rate_decay': False}


@pytest.mark.parametrize(('command', 'given', 'whose'), [
    ('train', 'seed:=3', 'agent'), ('land', 'seed:=3', 'launch'),
    ('evaluate', 'seed:=3', 'launch'), ('fly', 'seed:=3', 'agent'),
    ('land', 'level:=3', 'launch'), ('evaluate', 'level:=3', 'launch'),
    ('fly', 'level:=3', 'agent'), ('fly', 'lean:=10', 'agent'),
    ('fly', 'dry_mass:=3', 'simulator'),
    ('land', 'wind_speed_high:=3', 'simulator'), ('evaluate', 'ignitions:=1', 'simulator'),
    ('train', 'acknowledge:=always', 'agent'), ('train', 'ignitions:=1', 'simulator')])
def test_a_name_known_to_several_nodes_goes_to_one(command: str, given: str, whose: str) -> None:
    found = parse(command, given)
    got = {'launch': found.launch, 'agent': found.agent, 'simulator': found.simulator}
    assert {name for name, values in got.items() if values} == {whose}


def test_conditions_and_observation_of_train_go_to_launch_and_agent() -> None:
    found = parse('train', 'conditions:=mix', 'observation:=extended')
    assert found.launch == found.agent == {'conditions': 'mix', 'observation': 'extended'}
    assert parse('land', 'conditions:=mix').agent == {}


@pytest.mark.parametrize(('given', 'got'), [
    ('output:=~/flight.rrd', 'output:=/home/me/flight.rrd'), ('output:=/a/b.rrd', None),
    ('output:=b.rrd', f'output:={SCRIPTS}/b.rrd'), ('output:=~b.rrd', f'output:={SCRIPTS}/~b.rrd'),
    ('seed:=12', None), ('namespace:=x', 'namespace:=/x'), ('namespace:=/x/y', None),
    ('namespace:=', ''), ('policy:=', ''), ('policy:=robust', None),
    ('policy:=evaluate', f'policy:={SCRIPTS}/evaluate'), ('policy:=/a/b,c.x', None),
    ('policy:=a,b.safetensors', f'policy:={SCRIPTS}/a,b.safetensors'),
    ('pilots:=robust,expert', None), ('pilots:=', ''), ('pilots:=expert,', 'pilots:=expert'),
    ('simulator_parameters:=v.yaml', f'simulator_parameters:={SCRIPTS}/v.yaml'),
    ('pilots:=robust,runs/a/p.safetensors,~/b,/c',
     f'pilots:=robust,{SCRIPTS}/runs/a/p.safetensors,/home/me/b,/c')])
def test_paths_and_names_mean_the_same_to_every_node(
        given: str, got: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(SCRIPTS)
    monkeypatch.setenv('HOME', '/home/me')
    launch = parse('evaluate', given).launch
    assert [f'{name}:={value}' for name, value in launch.items()] == (
        [given if got is None else got] if got != '' else [])


@pytest.mark.parametrize(('command', 'given', 'message'), [
    *((command, ['conditions:=foo'], "conditions: got 'foo', expected one of nominal, mix, harsh")
      for command in arguments.COMMANDS),
    *((command, ['world:=mars'], "world: got 'mars', expected one of rocket, rocket_planar, lunar")
      for command in arguments.COMMANDS),
    ('train', ['conditions:=all'], "conditions: got 'all', expected one of nominal, mix"),
    ('evaluate', ['world:=lunar_lander', 'conditions:=all'],
     "conditions: got 'all', expected none, as world 'lunar_lander' has no conditions"),
    ('land', ['world:=lunar_lander', 'observation:=extended'],
     "observation: got 'extended', expected one of standard"),
    ('train', ['second_simulator:=/b'], "second_simulator: got '/b', expected a word of letters"),
    ('train', ['seed=3'], "got 'seed=3', expected NAME:=VALUE, for example seed:=3"),
    ('fly', ['world'], "got 'world', expected NAME:=VALUE"),
    ('train', ['max_trust:=3'], "unknown argument 'max_trust', did you mean 'max_thrust'?"),
    ('train', ['clip_rang:=3'], "unknown argument 'clip_rang', did you mean 'clip_range'?"),
    ('train', ['simulator_paramters:=x'], "unknown argument 'simulator_paramters', did you mean "),
    ('fly', ['levle:=3'], "unknown argument 'levle', did you mean 'level'?"),
    ('land', ['clip_range:=3'], "unknown argument 'clip_range', "),
    ('land', ['qqq:=3'], "unknown argument 'qqq', expected one of those in --help"),
    ('train', ['stance:=3'],
     "unknown argument 'stance' for world rocket, expected it only with world rocket_planar"),
    ('train', ['mode:=infer'],
     "mode: got 'infer', expected none: this command trains; ./launch_scripts/land flies"),
    ('train', ['level:=3'],
     "level: got '3', expected curriculum_start_level and curriculum_final_level instead"),
    ('train', ['preset:=fast'], "preset: got 'fast', expected one of default, from_scratch"),
    ('train', ['world:=rocket_planar', 'preset:=robust'], "preset: got 'robust', expected one of"),
    ('train', ['preset:=robust', 'engine_lag_high:=0.3'],
     "engine_lag_high: got '0.3', expected none beside conditions 'mix'"),
    ('evaluate', ['conditions:=harsh', 'ignitions:=3'],
     "ignitions: got '3', expected none beside conditions 'harsh'"),
    ('train', ['gamma:=2'], 'gamma: got 2, expected 0 to 1'),
    ('train', ['n_steps:=x'], "n_steps: got 'x', expected a number"),
    ('train', ['hidden_sizes:=[64,x]'], "hidden_sizes: got 'x', expected a number"),
    ('train', ['start_copies:=2', 'curriculum_start_reach:=2'],
     'start_copies: got 2, expected 1 with curriculum_start_reach 2'),
    ('train', ['max_thrust:=-1'], 'max_thrust: got -1, expected 0 to 1e+09 N'),
    *(('land', [f'namespace:={name}'], f"namespace: got '/{name}', expected words of letters")
      for name in ('a b', '1a', 'a//b', 'a/', 'a-b', '~', 'x' * 200)),
    ('train', ['num_envs:=0'], "num_envs: got '0', expected a whole number from 1"),
    ('land', ['web_port:=-1'], "web_port: got '-1', expected a whole number from 0"),
    ('fly', ['realtime_factor:=slow'], "realtime_factor: got 'slow', expected a number"),
    ('train', ['record:=yes'], "record: got 'yes', expected true or false"),
    ('land', ['mode:=fast'], "mode: got 'fast', expected one of lockstep, realtime"),
    ('evaluate', ['pilot:=me'], "pilot: got 'me', expected one of policy, expert"),
    ('train', ['seed:=1', 'seed:=2'], 'seed: given twice'),
    ('land', ['episodes:=8', 'namespace:=', 'namespace:='], 'namespace: given twice'),
    ('train', ['resume:=true'], 'resume:=true needs run_dir:=FOLDER'),
    ('train', ['agent_settings:=mine.yaml', 'seed:=7'],
     "agent_settings: got a file and 'seed' beside it, expected one of the two")])
def test_wrong_arguments_are_named(command: str, given: list[str], message: str) -> None:
    with pytest.raises((ValueError, TypeError)) as caught:
        parse(command, *given)
    assert str(caught.value).startswith(message)


def test_a_resumed_run_keeps_the_settings_of_its_world(tmp_path: Path) -> None:
    (tmp_path / 'config.yaml').write_text(yaml.safe_dump({
        'world': 'lunar_lander', 'num_envs': 32, 'conditions': 'custom',
        'observation': 'standard', 'training': {'world': 'not this'}}))
    resumed = parse('train', f'run_dir:={tmp_path}', 'resume:=true', 'gravity:=3')
    assert resumed.saved == {
        'world': 'lunar_lander', 'num_envs': '32', 'observation': 'standard'}
    assert (resumed.world, resumed.simulator) == ('lunar_lander', {'gravity': 3.0})
    assert parse('train', f'run_dir:={tmp_path}').saved == {}
    (tmp_path / 'config.yaml').write_text('{')
    with pytest.raises(ValueError, match='damaged'):
        parse('train', f'run_dir:={tmp_path}', 'resume:=true')


def test_parameters_declared_without_ros_match_the_nodes() -> None:
    train = {info.name: info for info in settings.describe(FleetConfig)}
    declared = {info.name: info for cls in (TrainingParameters, ConnectionParameters)
            for info in settings.describe(cls)}
    assert train == {name: declared[name] for name in train}
    assert declared.keys() - train.keys() <= parse('train').declared.keys()
    assert train['acknowledge'].choices == qos.ACKNOWLEDGE
    assert arguments.CHOICES['pilot'] == choice.NAMES
    modes, = (i.choices for i in settings.describe(SimulatorParameters) if i.name == 'mode')
    assert arguments.CHOICES['mode'] == modes
    fly = {info.name for group in arguments.agent_settings('fly').values() for info in group}
    assert {info.name for info in settings.describe(KeyboardParameters)} - fly == {'watch'}


def test_the_launcher_starts_without_slow_imports() -> None:
    code = ('import sys; import ppo_agent_node.commands.launch; '
            "print({'torch', 'rclpy', 'scipy', 'matplotlib', 'rerun'} & set(sys.modules))")
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == 'set()\n'
