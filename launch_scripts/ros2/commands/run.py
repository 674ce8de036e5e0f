# SPDX-License-Identifier: Apache-2.0
"""The run command.

The executable takes the place of this process, so that signals and the exit status are its own.
"""
from __future__ import annotations

import argparse
import os
import sys

from ros2 import packages
from ros2.errors import CommandError
from ros2.verb import Verb


def run(args: argparse.Namespace) -> int:
    """Become the executable.

    :raises CommandError: when it cannot be found or started.
    """
    path = str(packages.executable(args.package_name, args.executable_name))
    sys.stdout.flush()
    try:
        os.execv(path, [path, *args.argv])
    except OSError as error:
        raise CommandError(f'{path}: {error.strerror}') from error


VERBS = {'': Verb('Run a package specific executable', run, {
    'package_name': {'help': 'Name of the ROS package'},
    'executable_name': {'help': 'Name of the executable'},
    'argv': {
        'nargs': argparse.REMAINDER, 'help': 'Pass arbitrary arguments to the executable'}})}
