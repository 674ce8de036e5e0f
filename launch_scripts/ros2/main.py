# SPDX-License-Identifier: Apache-2.0
"""The command line: which module answers which verb."""
from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence

from ros2.errors import CommandError

_COMMANDS = {
    'run': 'Run a package specific executable',
    'launch': 'Run a launch file',
    'pkg': 'Various package related sub-commands',
    'node': 'Various node related sub-commands',
    'topic': 'Various topic related sub-commands',
    'service': 'Various service related sub-commands',
    'param': 'Various param related sub-commands',
    'interface': 'Show information about ROS interfaces',
}
_VERBS = {
    'pkg': {
        'executables': 'Output a list of package specific executables',
        'list': 'Output a list of available packages',
        'prefix': 'Output the prefix path of a package',
    },
    'node': {'list': 'Output a list of available nodes'},
    'topic': {
        'list': 'Output a list of available topics',
        'echo': 'Output messages from a topic',
        'hz': 'Print the average publishing rate to screen',
    },
    'service': {
        'list': 'Output a list of available services',
        'call': 'Call a service',
    },
    'param': {
        'list': 'Output a list of available parameters',
        'get': 'Get parameter',
        'set': 'Set parameter',
    },
    'interface': {'show': 'Output the interface definition'},
}


def _table(title: str, entries: dict[str, str]) -> str:
    lines = [f'  {name:<12}{text}' for name, text in entries.items()]
    return '\n'.join([f'{title}:', *lines])


def _module(argv: Sequence[str]) -> tuple[str, list[str]]:
    """Return the module that answers `argv` and the arguments left for it.

    :raises CommandError: when no module does.
    """
    command = argv[0]
    if command not in _COMMANDS:
        raise CommandError(
            f"ros2: error: argument Call `ros2 <command> -h` for more detailed usage.: invalid "
            f"choice: '{command}' (choose from {', '.join(map(repr, _COMMANDS))}). This is the "
            "stand-in for environments of wheels; a full ROS 2 has the rest.")
    verbs = _VERBS.get(command)
    if verbs is None:
        name = 'launch.command' if command == 'launch' else command
        return f'ros2.{name}', list(argv[1:])
    verb = argv[1] if len(argv) > 1 else '-h'
    if verb in ('-h', '--help'):
        print(f'usage: ros2 {command} [-h] <verb> ...\n\n' + _table('Verbs', verbs))
        raise SystemExit(0)
    if verb not in verbs:
        raise CommandError(
            f"ros2 {command}: error: argument Call `ros2 {command} <verb> -h` for more detailed "
            f"usage.: invalid choice: '{verb}' (choose from {', '.join(map(repr, verbs))}).")
    return f'ros2.{command}_{verb}', list(argv[2:])


def main(argv: Sequence[str] | None = None) -> int | str:
    """Run one command; returns what belongs into sys.exit()."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments == ['--use-python-default-buffering']:
        arguments = []
    if not arguments or arguments[0] in ('-h', '--help'):
        print('usage: ros2 [-h] <command> ...\n\n' + _table('Commands', _COMMANDS))
        return 0
    try:
        name, rest = _module(arguments)
        module = importlib.import_module(name)
        prog = ' '.join(['ros2', *arguments[:len(arguments) - len(rest)]])
        parser = argparse.ArgumentParser(
            prog=prog, description=(module.__doc__ or '').splitlines()[0],
            formatter_class=argparse.RawDescriptionHelpFormatter)
        module.add_arguments(parser)
        return module.main(parser.parse_args(rest)) or 0
    except CommandError as error:
        return str(error)
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # Whoever read our output is gone; nobody is left to tell.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return 1
