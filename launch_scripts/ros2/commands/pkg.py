# SPDX-License-Identifier: Apache-2.0
"""Packages: their names, executables and folders."""
from __future__ import annotations

import argparse

from ros2 import packages
from ros2.errors import CommandError
from ros2.verb import Verb


def executables(args: argparse.Namespace) -> None:
    """Print one executable a line."""
    for name in [args.package_name] if args.package_name else packages.names():
        for path in packages.executables_of(name):
            print(f'{name} {path.name}')


def names(args: argparse.Namespace) -> None:
    """Print one package a line."""
    for name in packages.names():
        print(name)


def prefix(args: argparse.Namespace) -> None:
    """Print the folder in which a package is installed, or its share folder."""
    find = packages.share_of if args.share else packages.prefix_of
    try:
        print(find(args.package_name))
    except packages.PackageNotFoundError:
        raise CommandError('Package not found') from None


VERBS = {
    'executables': Verb(
        'Output a list of package specific executables', executables,
        {'package_name': {'nargs': '?', 'help': 'The package name'}}),
    'list': Verb('Output a list of available packages', names),
    'prefix': Verb(
        'Output the prefix path of a package', prefix,
        {'package_name': {'help': 'The package name'},
         '--share': {
             'action': 'store_true', 'help': 'Show share directory for the package'}}),
}
