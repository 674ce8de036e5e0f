# SPDX-License-Identifier: Apache-2.0
"""Output a list of package specific executables."""
from __future__ import annotations

import argparse

from ros2 import packages


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('package_name', nargs='?', help='The package name')
    parser.add_argument(
        '--full-path', action='store_true', help='Show the full path of each executable')


def main(args: argparse.Namespace) -> None:
    """Print one executable a line."""
    for name in [args.package_name] if args.package_name else packages.names():
        for path in packages.executables_of(name):
            print(path if args.full_path else f'{name} {path.name}')
