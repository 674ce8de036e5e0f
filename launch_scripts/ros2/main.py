# SPDX-License-Identifier: Apache-2.0
"""The command line: which module answers which command, and which of its verbs."""
from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence

from ros2.errors import FULL
from ros2.errors import CommandError
from ros2.verb import Verb

_COMMANDS = {
    'run': 'Run a package specific executable',
    'launch': 'Run a launch file',
    'pkg': 'Various package related sub-commands',
    'node': 'Various node related sub-commands',
    'topic': 'Various topic related sub-commands',
    'service': 'Various service related sub-commands',
    'action': 'Various action related sub-commands',
    'param': 'Various param related sub-commands',
    'interface': 'Show information about ROS interfaces',
    'bag': 'Various rosbag related sub-commands',
}


def _table(title: str, entries: dict[str, str]) -> str:
    lines = [f'  {name:<12}{text}' for name, text in entries.items()]
    return '\n'.join([f'{title}:', *lines])


def _choose(argv: list[str]) -> tuple[Verb, int]:
    """Return the verb that `argv` begins with, and of how many words it is.

    :raises CommandError: when it is not known.
    """
    command = argv[0]
    if command not in _COMMANDS:
        raise CommandError(
            f"ros2: error: argument Call `ros2 <command> -h` for more detailed usage.: invalid "
            f"choice: '{command}' (choose from {', '.join(map(repr, _COMMANDS))}); {FULL}")
    module = 'ros2.launch.command' if command == 'launch' else f'ros2.commands.{command}'
    verbs: dict[str, Verb] = importlib.import_module(module).VERBS
    if '' in verbs:
        return verbs[''], 1
    verb = argv[1] if len(argv) > 1 else '-h'
    if verb in ('-h', '--help'):
        print(f'usage: ros2 {command} [-h] <verb> ...\n\n' + _table(
            'Verbs', {name: verb.help for name, verb in verbs.items()}))
        raise SystemExit(0)
    if verb not in verbs:
        raise CommandError(
            f"ros2 {command}: error: argument Call `ros2 {command} <verb> -h` for more detailed "
            f"usage.: invalid choice: '{verb}' (choose from {', '.join(map(repr, verbs))}); "
            f'{FULL}')
    return verbs[verb], 2


def main(argv: Sequence[str] | None = None) -> int | str:
    """Run one command; returns what belongs into sys.exit()."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] in ('-h', '--help'):
        print('usage: ros2 [-h] <command> ...\n\n' + _table('Commands', _COMMANDS))
        return 0
    try:
        verb, words = _choose(arguments)
        prog = ' '.join(['ros2', *arguments[:words]])
        return verb.main(verb.parse(prog, arguments[words:])) or 0
    except CommandError as error:
        return str(error)
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader of the output is gone, so no message would be read.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return 1
