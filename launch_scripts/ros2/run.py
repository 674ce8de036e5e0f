# SPDX-License-Identifier: Apache-2.0
"""Run a package specific executable.

The executable takes the place of this process, so that signals and the exit status are its own.
"""
from __future__ import annotations

import argparse
import os
import shlex
import sys

from ros2 import packages
from ros2.errors import CommandError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        '--prefix',
        help='Prefix command, which should go before the executable. Command must be wrapped in '
             "quotes if it contains spaces (e.g. --prefix 'gdb -ex run --args').")
    parser.add_argument('package_name', help='Name of the ROS package')
    parser.add_argument('executable_name', help='Name of the executable')
    parser.add_argument(
        'argv', nargs=argparse.REMAINDER, help='Pass arbitrary arguments to the executable')


def command(args: argparse.Namespace) -> list[str]:
    """Return the command line to run.

    :raises CommandError: when the executable cannot be found.
    """
    path = packages.executable(args.package_name, args.executable_name)
    return [*shlex.split(args.prefix or ''), str(path), *args.argv]


def main(args: argparse.Namespace) -> int:
    """Become the executable."""
    line = command(args)
    sys.stdout.flush()
    try:
        os.execvp(line[0], line)
    except OSError as error:
        raise CommandError(f'{line[0]}: {error.strerror}') from error
