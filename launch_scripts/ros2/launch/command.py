# SPDX-License-Identifier: Apache-2.0
"""Run a launch file.

Unlike the real command this one gives a process the terminal itself when it is the only one with
`output: screen` and we have a terminal; it shows the last lines of a process that failed; it
returns 1 when a process has failed; and it leaves no process behind.
"""
from __future__ import annotations

import argparse
import asyncio
import os
import sys
from pathlib import Path

from ros2 import packages
from ros2.errors import CommandError
from ros2.launch.actions import Plan
from ros2.launch.actions import carry_out
from ros2.launch.actions import choices_of
from ros2.launch.context import Context
from ros2.launch.context import parse_arguments
from ros2.launch.entity import Entity
from ros2.launch.entity import load
from ros2.launch.log import Log
from ros2.launch.log import new_folder
from ros2.launch.service import Service
from ros2.launch.substitutions import Substitution
from ros2.launch.substitutions import parse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        '-n', '--noninteractive', action='store_true', default=not sys.stdin.isatty(),
        help='Run the launch system non-interactively, with no terminal associated')
    parser.add_argument(
        '-d', '--debug', action='store_true',
        help='Put the launch system in debug mode, provides more verbose output.')
    parser.add_argument(
        '-s', '--show-args', '--show-arguments', action='store_true',
        help='Show arguments that may be given to the launch file.')
    parser.add_argument(
        '-a', '--show-all-subprocesses-output', action='store_true',
        help="Show all launched subprocesses' output")
    parser.add_argument(
        'package_name', help='Name of the ROS package which contains the launch file')
    parser.add_argument('launch_file_name', nargs='?', help='Name of the launch file')
    parser.add_argument(
        'launch_arguments', nargs='*',
        help="Arguments to the launch file; '<name>:=<value>' (for duplicates, last one wins)")


def locate(args: argparse.Namespace) -> tuple[Path, list[str]]:
    """Return the launch file and its arguments.

    :raises CommandError: when there is no such file.
    """
    path = Path(args.package_name)
    rest = list(args.launch_arguments)
    if path.is_file():
        return path, [args.launch_file_name, *rest] if args.launch_file_name else rest
    if path.exists() or args.launch_file_name is None or os.sep in args.package_name:
        raise CommandError(f"No launch file supplied: '{path}' is no file")
    share = packages.share_of(args.package_name)
    matches = [p for p in share.rglob(args.launch_file_name) if p.is_file()]
    if len(matches) != 1:
        times = 'found more than once' if matches else 'not found'
        raise CommandError(
            f"file '{args.launch_file_name}' was {times} in the share directory of package "
            f"'{args.package_name}' which is at '{share}'")
    return matches[0], rest


def _all(entities: list[Entity]) -> list[Entity]:
    return [inner for entity in entities
            for inner in (_all(entity.children()) if entity.kind == 'group' else [entity])]


def _describe(text: str) -> str:
    parts = []
    for part in parse(text) or ('',):
        if isinstance(part, Substitution):
            inner = ' '.join(str(x) for argument in part.arguments for x in argument)
            parts.append(f'$({part.name} {inner})'.replace(' )', ')'))
        else:
            parts.append(f"'{part}'")
    return ' + '.join(parts)


def show_arguments(path: Path) -> None:
    """Print the arguments that a launch file declares."""
    print("Arguments (pass arguments as '<name>:=<value>'):")
    arguments = [entity for entity in _all(load(path)) if entity.kind == 'arg']
    for entity in arguments:
        text = entity.get('description')
        choices = choices_of(entity)
        if text is None:
            text = f'One of: {choices}' if choices else 'no description given'
        elif choices:
            text = f'{text}{"" if text.endswith(".") else "."} Valid choices are: {choices}'
        print(f"\n    '{entity.need('name')}':\n        {text}")
        default = entity.get('default')
        if default is not None:
            print(f'        (default: {_describe(default)})')
    if not arguments:
        print('\n  No arguments.')


def main(args: argparse.Namespace) -> int:
    """Launch, or show the arguments."""
    path, texts = locate(args)
    if args.show_args:
        show_arguments(path)
        return 0
    if args.show_all_subprocesses_output:
        os.environ['OVERRIDE_LAUNCH_PROCESS_OUTPUT'] = 'both'
    arguments = parse_arguments(texts)
    folder = new_folder()
    try:
        log = Log(folder, args.debug)
    except OSError as error:
        raise CommandError(f'no log can be written below {folder}: {error.strerror}') from None
    plan = Plan()
    try:
        carry_out(path, Context(arguments, dict(os.environ), folder), plan)
    except CommandError as error:
        log.header()
        log.message('ERROR', 'launch', f'Caught exception in launch: {error}')
        return 1
    terminal = sys.stdout.isatty() and sys.stderr.isatty()

    async def run() -> int:
        service = Service(plan.processes, log, terminal)
        log.header()
        for text in plan.messages:
            log.message('INFO', 'launch.user', text)
        return await service.run()

    try:
        return asyncio.run(run())
    finally:
        log.close()
