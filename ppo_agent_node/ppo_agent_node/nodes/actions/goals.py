# SPDX-License-Identifier: Apache-2.0
"""Goals of actions as the arguments of the commands that do the same."""
from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory

from ppo_agent_node.commands.arguments import ALL
from ppo_agent_node.commands.arguments import full_name
from ppo_agent_node.commands.arguments import parse
from ppo_agent_node.commands.launch import Start
from ppo_agent_node.commands.launch import prepare
from ppo_agent_node.pilots.search import find_policy


class _Start(Start):
    """Start of a launch file that is installed."""

    @property
    def runs(self) -> Path:
        """Folder of all runs: where the server was started, as for a node without a script."""
        return Path.cwd() / 'runs'


def launch_file(command: str) -> Path:
    """Return the launch file of a command."""
    share = Path(get_package_share_directory('ppo_agent_node'))
    return share / 'launch' / f'{command}.launch.yaml'


def goal_arguments(goal: Any) -> list[str]:
    """Return the arguments of the command, `NAME:=VALUE`, that mean the same as a goal.

    They are the fields that differ from their defaults, and the goal's own list of arguments.

    :raises ValueError: for one in that list that is named twice, is a field, or is the server's.
    """
    usual = type(goal)()
    fields = [name for name in goal.get_fields_and_field_types() if name != 'arguments']
    given = {name: getattr(goal, name) for name in fields}
    texts = {
        name: f'{name}:={str(value).lower() if isinstance(value, bool) else value}'
        for name, value in given.items() if value != getattr(usual, name)}
    for text in goal.arguments:
        name = text.partition(':=')[0]
        if name == 'namespace':
            raise ValueError(f'arguments: got {text!r}, expected none: the server chooses it')
        if name in fields:
            raise ValueError(f'arguments: got {text!r}, expected field {name} of the goal instead')
        if name in texts:
            raise ValueError(f'arguments: got {texts[name]!r} and {text!r}, expected one of them')
        texts[name] = text
    return list(texts.values())


def start_of(command: str, goal: Any, namespace: str, scratch: Path) -> Start:
    """Return the start that a goal asks for, checked; its files and folders are made.

    :param command: train, evaluate or land.
    :param namespace: of the server, in which the started nodes have their own.
    :param scratch: temporary folder, which must exist as long as what is started.
    :raises ValueError: naming a field or an argument, what was given and what was expected.
    :raises TypeError: for a value of another kind.
    :raises OSError: when a file or folder cannot be read or made.
    """
    file = launch_file(command)
    texts = goal_arguments(goal)
    if command == 'evaluate':
        if goal.conditions == ALL:
            raise ValueError(
                f'conditions: got {ALL!r}, expected one set: the result has the figures of one')
        if not goal.output:  # the figures of the result come from its files
            texts.append(f'output:={scratch / "figures"}')
            if not any(text.startswith('plots:=') for text in texts):
                texts.append('plots:=false')
    arguments = parse(command, file, [
        *texts, f'namespace:={full_name(namespace, command)}'])
    if policy := arguments.launch.get('policy'):
        find_policy(policy, arguments.world)
    start = _Start(str(file.with_name(command)), os.getpid(), scratch, arguments)
    prepare(start)
    return start
