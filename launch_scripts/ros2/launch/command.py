# SPDX-License-Identifier: Apache-2.0
"""The launch command.

Unlike the real command this one gives a process the terminal itself when it is the only one with
`output: screen` and we have a terminal; it shows the last lines of a process that failed; it
returns the status of the first that failed, 1 where a signal ended it; and it leaves no process
behind.
"""
from __future__ import annotations

import argparse
import asyncio
import os
import sys
from pathlib import Path

from ros2 import packages
from ros2.errors import CommandError
from ros2.launch.actions import carry_out
from ros2.launch.context import Context
from ros2.launch.context import parse_arguments
from ros2.launch.log import Log
from ros2.launch.log import new_folder
from ros2.launch.service import Service
from ros2.verb import Verb


def locate(args: argparse.Namespace) -> tuple[Path, list[str]]:
    """Return the launch file and its arguments.

    :raises CommandError: when there is no such file.
    """
    path = Path(args.package_name)
    rest = list(args.launch_arguments)
    if path.is_file():
        return path, [args.launch_file_name, *rest] if args.launch_file_name else rest
    if args.launch_file_name is None or os.sep in args.package_name:
        raise CommandError(f"No launch file supplied: '{path}' is no file")
    share = packages.share_of(args.package_name)
    matches = [p for p in share.rglob(args.launch_file_name) if p.is_file()]
    if len(matches) != 1:
        times = 'found more than once' if matches else 'not found'
        raise CommandError(
            f"file '{args.launch_file_name}' was {times} in the share directory of package "
            f"'{args.package_name}' which is at '{share}'")
    return matches[0], rest


def launch(args: argparse.Namespace) -> int:
    """Run a launch file."""
    path, texts = locate(args)
    arguments = parse_arguments(texts)
    folder = new_folder()
    try:
        log = Log(folder)
    except OSError as error:
        raise CommandError(f'no log can be written below {folder}: {error.strerror}') from None
    try:
        plans = carry_out(path, Context(arguments, folder))
    except CommandError as error:
        log.header()
        log.message('ERROR', 'launch', f'Caught exception in launch: {error}')
        return 1
    terminal = sys.stdout.isatty() and sys.stderr.isatty()

    async def run() -> int:
        service = Service(plans, log, terminal)
        log.header()
        return await service.run()

    try:
        return asyncio.run(run())
    finally:
        log.close()


VERBS = {'': Verb('Run a launch file', launch, {
    '-n --noninteractive': {
        'action': 'store_true',
        'help': 'Run the launch system non-interactively, with no terminal associated'},
    'package_name': {'help': 'Name of the ROS package which contains the launch file'},
    'launch_file_name': {'nargs': '?', 'help': 'Name of the launch file'},
    'launch_arguments': {
        'nargs': '*',
        'help': "Arguments to the launch file; '<name>:=<value>' (for duplicates, last one wins)"},
})}
