# SPDX-License-Identifier: Apache-2.0
"""Output the prefix path of a package."""
from __future__ import annotations

import argparse

from ros2 import packages
from ros2.errors import CommandError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('package_name', help='The package name')
    parser.add_argument(
        '--share', action='store_true', help='show share directory for the package')


def main(args: argparse.Namespace) -> None:
    """Print the folder."""
    try:
        print((packages.share_of if args.share else packages.prefix_of)(args.package_name))
    except packages.PackageNotFoundError:
        raise CommandError('Package not found') from None
