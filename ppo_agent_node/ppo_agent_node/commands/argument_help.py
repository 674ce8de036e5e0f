# SPDX-License-Identifier: Apache-2.0
"""The text of `--help`: a command's arguments with the defaults that would apply."""
from __future__ import annotations

import textwrap
from collections.abc import Iterable
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ppo_agent_node.commands.arguments import SET_BY_AGENT
from ppo_agent_node.commands.arguments import Arguments
from ppo_agent_node.commands.arguments import agent_settings
from ppo_agent_node.commands.arguments import full_name
from ppo_agent_node.commands.arguments import simulator_settings
from ppo_agent_node.commands.arguments import unknown
from ppo_agent_node.commands.parameter_file import read_parameters
from ppo_agent_node.config import presets
from rocket_sim_node.settings import SettingInfo
from rocket_sim_node.worlds.rocket import conditions

WIDTH = 99
_COLUMN = 24
PURPOSE = {
    'train': 'Trains a policy, evaluates it and records its flights: simulators, agent and '
             'recorder as separate processes over DDS.',
    'land': 'Flies the policy of the newest finished run, or the shipped policy if there is no '
            'run, and records the flights.',
    'evaluate': 'Flies a policy or a pilot for many episodes and prints a table. With an output '
                'folder it also writes evaluation.json, plots and a report page.',
    'fly': 'Lets you fly with the keys of this terminal and shows the flight live in Rerun.'}
"""Purpose of each command."""
_WHOSE = {'train': 'agent', 'fly': 'pilot'}
_FILES = ('agent_parameters', 'agent_overrides', 'agent_settings')
"""launch arguments that name parameter files of the agent; each overrides those before it"""


def help_text(script: str, found: Arguments, decided: Mapping[str, str]) -> str:
    """Return how to call a command.

    :param script: the command, as it was called.
    :param found: arguments given in addition to `--help`, on which the defaults depend.
    :param decided: arguments of the launch that the command sets itself.
    """
    values = found.values({**decided, **found.launch})
    root = f'{found.file.parents[2]}/'
    lines = [f'Usage: {script} [NAME:=VALUE ...]', '']
    lines += [*textwrap.wrap(PURPOSE[found.command], WIDTH), '', 'Arguments:']
    for name, argument in found.declared.items():
        default = values[name].removeprefix(root)
        lines += _entry(name, argument.description, default)
    for title, infos, given in _groups(found, values):
        lines += ['', *textwrap.wrap(title, WIDTH)]
        lines += textwrap.wrap(
            ' '.join(f'{info.name}:={_shown(given.get(info.name, info.default))}'
                     for info in infos),
            WIDTH, initial_indent='  ', subsequent_indent='  ', break_on_hyphens=False,
            break_long_words=False)
    lines += ['', f'{script} --help NAME ... explains them.']
    return '\n'.join(lines) + '\n'


def explanation(
    names: Iterable[str], found: Arguments, decided: Mapping[str, str],
) -> str:
    """Return what arguments mean, and their defaults.

    :raises ValueError: for a name that the command does not know.
    """
    values = found.values({**decided, **found.launch})
    lines: list[str] = []
    groups = [(info, given) for _, infos, given in _groups(found, values) for info in infos]
    known = {info.name: (info, given) for info, given in groups}
    for name in names:
        if name in found.declared:
            lines += _entry(name, found.declared[name].description, values[name])
        elif name in known:
            info, given = known[name]
            lines += _entry(
                name, f'{info.description}{_range(info)}',
                _shown(given.get(name, info.default)))
        else:
            raise unknown(name, found.world, (*found.declared, *known))
    return '\n'.join(lines) + '\n'


def _entry(name: str, description: str, default: str) -> list[str]:
    return textwrap.wrap(
        f'{description} [{default}]' if default else description, WIDTH,
        initial_indent=f'  {name:<{_COLUMN - 3}} ', subsequent_indent=' ' * _COLUMN,
        break_on_hyphens=False, break_long_words=False)


def _range(info: SettingInfo) -> str:
    unit = f' {info.unit}' if info.unit else ''
    if info.choices:
        return f'; one of {", ".join(choice or "none" for choice in info.choices)}'
    if isinstance(info.default, bool | str):
        return ''
    form = '.0f' if isinstance(info.default, int) else 'g'
    return f'; {info.low:{form}} to {info.high:{form}}{unit}'


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple | list):
        return f'[{",".join(map(str, value))}]'
    return f'{value:g}' if isinstance(value, float) else str(value)


def _groups(
    found: Arguments, values: Mapping[str, str],
) -> Iterable[tuple[str, list[SettingInfo], Mapping[str, Any]]]:
    """Yield the settings that are not arguments of the launch: title, settings, given values."""
    given: dict[str, Any] = {}
    if found.command == 'train':
        given.update(presets.preset_values(found.preset, found.world))
        for name in _FILES:
            given.update(read_parameters(
                Path(values[name]), full_name(values['namespace'], 'ppo_agent')))
    agent = agent_settings(found.command)
    for group, infos in agent.items():
        yield (
            f'Settings of the {_WHOSE[found.command]}, {group}:',
            [info for info in infos if info.name not in found.declared],
            {**given, **found.agent})
    taken = {info.name for infos in agent.values() for info in infos} | found.declared.keys()
    taken |= SET_BY_AGENT.keys() if found.command == 'train' else set()
    own = [info for info in simulator_settings(found.world) if info.name not in taken]
    simulator = full_name(values['namespace'], 'simulator')
    given = {**read_parameters(Path(values['simulator_parameters']), simulator),
            **found.simulator}
    drawn = values['conditions'] or given.get('conditions', '')
    if drawn in conditions.NAMES and drawn != 'nominal':
        given = {**conditions.settings(drawn), **given}
    ranges = [info for info in own if info.name in conditions.FLAT_NAMES]
    yield f"Settings of world '{found.world}':", [i for i in own if i not in ranges], given
    if ranges:
        yield 'Ranges of its conditions:', ranges, given
