# SPDX-License-Identifier: Apache-2.0
"""The arguments of train, land, evaluate and fly: checked, and sent where they belong.

An argument belongs to the launch file, else to the agent (for `fly`, to the pilot), else to the
world that the simulator runs.
"""
from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field
from dataclasses import fields
from pathlib import Path
from typing import Any

from ppo_agent_node.commands.launch_file import LaunchArgument
from ppo_agent_node.commands.launch_file import read_launch_file
from ppo_agent_node.commands.launch_file import resolved
from ppo_agent_node.config import presets
from ppo_agent_node.config import training_config
from ppo_agent_node.config.connection_config import FleetConfig
from ppo_agent_node.config.training_config import Config
from ppo_agent_node.runs.config_file import read_config
from rocket_sim_node import settings
from rocket_sim_node import worlds
from rocket_sim_node.command_line import read_value
from rocket_sim_node.ros_environment import LONGEST_NAMESPACE
from rocket_sim_node.ros_environment import NAME
from rocket_sim_node.ros_environment import check_name
from rocket_sim_node.settings import SettingInfo
from rocket_sim_node.worlds.rocket import conditions

COMMANDS = ('train', 'land', 'evaluate', 'fly')
ALL = 'all'
"""conditions of `evaluate`: the whole table"""
CHOICES = {
    'mode': ('lockstep', 'realtime'),
    'pilot': ('policy', 'expert', 'expert_estimator', 'random')}
"""Choices of node parameters, repeated because nodes cannot be imported without ROS."""
_NAMESPACE = re.compile(rf'(/|(/{NAME.pattern})+)')
_ARGUMENT = re.compile(r'([a-z_][a-z0-9_]*):=(.*)', re.DOTALL)
_KEPT_BY_RUN = ('world', 'num_envs', 'conditions', 'observation')
SET_BY_AGENT = {
    'level': 'curriculum_start_level and curriculum_final_level', 'spawn_copies': 'start_copies',
    'spawn_reach': 'curriculum_start_reach', 'spawn_heading': 'curriculum_heading'}
"""World settings that a training controls, and the training settings that replace them."""


@dataclass
class Arguments:
    """Arguments of a command, grouped by recipient."""

    command: str
    file: Path
    """the launch file"""
    declared: Mapping[str, LaunchArgument]
    world: str
    given: dict[str, str] = field(default_factory=dict)
    """all of them, in their order; paths are absolute"""
    launch: dict[str, str] = field(default_factory=dict)
    """those of the launch file; an empty one means its default and is left out"""
    agent: dict[str, Any] = field(default_factory=dict)
    simulator: dict[str, Any] = field(default_factory=dict)
    saved: dict[str, str] = field(default_factory=dict)
    """what shaped the world of the run that is to be resumed"""

    @property
    def preset(self) -> str:
        """The preset of a training."""
        return self.launch.get('preset', presets.DEFAULT)

    def values(self, given: Mapping[str, str]) -> dict[str, str]:
        """Return the value of each argument of the launch: the one given, or else its default."""
        return resolved(self.declared, given, self.file.parent)

    def of_launch(self, name: str) -> str:
        """Return an argument of the launch: given, the run's or by default; empty: none."""
        return self.launch.get(name) or self.saved.get(name) or self.declared[name].default or ''


def parse(command: str, file: Path, texts: Iterable[str]) -> Arguments:
    """Return arguments of the form `NAME:=VALUE`, checked.

    :param file: the launch file of the command.
    :raises ValueError: naming an argument, what was given and what was expected.
    :raises TypeError: for a value of another kind.
    :raises OSError: when a file cannot be read.
    """
    declared = read_launch_file(file)
    given: dict[str, str] = {}
    for name, value in _pairs(texts):
        if name in given:
            raise ValueError(f'{name}: given twice')
        given[name] = _plain(name, value, declared)
    saved = _saved(given) if command == 'train' and given.get('resume') == 'true' else {}
    world = given.get('world') or saved.get('world') or declared['world'].default or ''
    found = Arguments(command, file, declared, world, given, saved=saved)
    one_of('world', world, worlds.names())
    agent = {info.name: info for group in agent_settings(command).values() for info in group}
    simulator = {info.name: info for info in simulator_settings(world)}
    for name, text in given.items():
        if name in declared:
            if text:
                declared[name].check(text)
                found.launch[name] = text
        elif name in agent:
            found.agent[name] = settings.check(agent[name], read_value(text, agent[name].default))
        elif name == 'mode' and command == 'train':
            raise ValueError(
                f'mode: got {text!r}, expected none: this command trains; ./launch_scripts/land '
                'flies a policy')
        elif name in simulator:
            found.simulator[name] = settings.check(
                simulator[name], read_value(text, simulator[name].default))
        else:
            raise unknown(name, world, (*declared, *agent, *simulator))
    _check(found)
    return found


def simulator_settings(world: str) -> tuple[SettingInfo, ...]:
    """Return the settings of a world and of how it is stepped."""
    return (*worlds.settings(world), *worlds.stepping_settings(world))


def agent_settings(command: str) -> dict[str, tuple[SettingInfo, ...]]:
    """Return what can be set of the agent or the pilot that a command starts, by group."""
    if command == 'train':
        return {
            **{concern.name: settings.describe(concern.default_factory)  # type: ignore[arg-type]
               for concern in fields(Config)},
            'connection': settings.describe(FleetConfig)}
    if command == 'fly':
        from ppo_agent_node.pilots.keyboard import KeyboardSettings
        from ppo_agent_node.pilots.keyboard import StartSettings
        return {
            'start': settings.describe(StartSettings), 'keys': settings.describe(KeyboardSettings)}
    return {}


def full_name(namespace: str, node: str) -> str:
    """Return the name of a node in a namespace, which may be empty."""
    return f'{namespace.rstrip("/")}/{node}'


def one_of(name: str, value: str, choices: Sequence[str]) -> None:
    """Check a value that is one of a few.

    :raises ValueError: naming it and them.
    """
    if value not in choices:
        raise ValueError(f'{name}: got {value!r}, expected one of {", ".join(choices)}')


def _pairs(texts: Iterable[str]) -> Iterable[tuple[str, str]]:
    for text in texts:
        match = _ARGUMENT.fullmatch(text)
        if not match:
            raise ValueError(
                f'got {text!r}, expected NAME:=VALUE, for example seed:=3 (see --help)')
        yield match[1], match[2]


def _plain(name: str, value: str, declared: Mapping[str, LaunchArgument]) -> str:
    """Return a value that means the same to every node: paths are absolute."""
    if value.lower() in ('true', 'false'):
        return value.lower()
    if name == 'namespace':
        return value if not value or value.startswith('/') else f'/{value}'
    if name in ('run_dir', 'output') or (name in declared and declared[name].is_path):
        return _absolute(value)
    if name == 'policy':
        return _absolute_policy(value)
    if name == 'loggers':
        return ','.join(_absolute(each) if '.py:' in each else each for each in value.split(','))
    if name == 'pilots':
        return ','.join(_absolute_policy(each) for each in value.split(',') if each)
    return value


def _absolute(path: str) -> str:
    # A shell leaves a ~ behind := as it is.
    if path.startswith('~/'):
        path = str(Path.home() / path[2:])
    return str(Path.cwd() / path) if path else ''


def _absolute_policy(name: str) -> str:
    """Return the path of a policy; a name that is not a file means a shipped policy."""
    return _absolute(name) if '.' in name or '/' in name or Path(name).is_file() else name


def _saved(given: Mapping[str, str]) -> dict[str, str]:
    """Return what shaped the world of a run that is resumed.

    :raises ValueError: when no run is named, or its settings are damaged.
    """
    if not given.get('run_dir'):
        raise ValueError('resume:=true needs run_dir:=FOLDER')
    config = read_config(Path(given['run_dir']) / 'config.yaml')
    return {
        name: str(config[name]) for name in _KEPT_BY_RUN
        if config.get(name) not in (None, '', 'custom')}


def unknown(name: str, world: str, known: Sequence[str]) -> ValueError:
    """Return the error of a name that a command does not know."""
    others = [
        other for other in worlds.names()
        if name in {info.name for info in simulator_settings(other)}]
    if others:
        return ValueError(
            f'unknown argument {name!r} for world {world}, expected it only with world '
            f'{" or ".join(others)}')
    close = difflib.get_close_matches(name, known, 1)
    return ValueError(f'unknown argument {name!r}' + (
        f', did you mean {close[0]!r}?' if close else ', expected one of those in --help'))


def _check(found: Arguments) -> None:
    """Check arguments that are names, and those that contradict each other.

    :raises ValueError: naming an argument.
    """
    drawn, world = found.of_launch('conditions'), found.world
    infos = {info.name: info for info in worlds.settings(world)}
    if drawn:
        more = (ALL,) if found.command == 'evaluate' else ()
        one_of('conditions', drawn, (*conditions.NAMES, *more))
        if drawn != 'nominal' and not infos.keys() >= set(conditions.FLAT_NAMES):
            raise ValueError(
                f'conditions: got {drawn!r}, expected none, as world {world!r} has no conditions')
    if 'observation' in found.declared and (seen := found.of_launch('observation')):
        known = infos['observation'].choices if 'observation' in infos else ('standard',)
        one_of('observation', seen, known)
    namespace = found.launch.get('namespace', '/')
    if not _NAMESPACE.fullmatch(namespace) or len(namespace) > LONGEST_NAMESPACE:
        raise ValueError(
            f'namespace: got {namespace!r}, expected words of letters, digits and _ that do not '
            f'begin with a digit, separated by /, {LONGEST_NAMESPACE} characters at most')
    if second := found.launch.get('second_simulator'):
        check_name('second_simulator', second)
    for name, choices in CHOICES.items():
        if name in found.declared:
            one_of(name, found.of_launch(name), choices)
    if found.command == 'train':
        one_of('preset', found.preset, presets.preset_names(world))
        _check_training(found)
        drawn = found.launch.get('conditions', '')
        if not drawn and not found.saved:
            drawn = presets.preset_values(found.preset, world).get('conditions', '')
    # These reset the simulator to their conditions, whatever it was started with.
    if drawn and found.command in ('train', 'evaluate'):
        for name in found.simulator.keys() & set(conditions.FLAT_NAMES):
            raise ValueError(
                f'{name}: got {found.given[name]!r}, expected none beside conditions {drawn!r}, '
                'which set it')


def _check_training(found: Arguments) -> None:
    """Check the arguments of a training, and copy shared ones to the agent.

    :raises ValueError: naming an argument.
    """
    for name in found.simulator.keys() & SET_BY_AGENT.keys():
        raise ValueError(
            f'{name}: got {found.given[name]!r}, expected {SET_BY_AGENT[name]} instead: a '
            'training changes it itself')
    # The agent resets its simulator to the conditions, and has to know what it observes.
    for name in ('conditions', 'observation'):
        if name in found.launch:
            found.agent[name] = found.launch[name]
    if found.agent and 'agent_settings' in found.launch:
        raise ValueError(
            f'agent_settings: got a file and {next(iter(found.agent))!r} beside it, expected one '
            'of the two')
    if not found.saved:
        known = {info.name for info in training_config.describe()}
        training_config.make_config({
            **presets.preset_values(found.preset, found.world),
            **{name: value for name, value in found.agent.items() if name in known}})
