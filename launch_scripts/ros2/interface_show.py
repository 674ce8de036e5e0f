# SPDX-License-Identifier: Apache-2.0
"""Output the interface definition."""
from __future__ import annotations

import argparse
import re

from ros2 import packages
from ros2.errors import CommandError

_FIELD = re.compile(r'\s*((?:\w+/)?[A-Z]\w*)(?:\[[^\]]*\])?\s+\w')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument('type', help='Show an interface definition (e.g. "std_msgs/msg/String")')
    parser.add_argument(
        '--no-comments', action='store_true', help='Show no comments or whitespace')


def lines(package: str, kind: str, name: str, comments: bool, indent: str = '') -> list[str]:
    """Return the definition, that of nested messages below their field, further in.

    :raises CommandError: when there is no such interface.
    """
    path = packages.share_of(package) / kind / f'{name}.{kind}'
    if not path.is_file():
        raise CommandError(f"Could not find the interface '{package}/{kind}/{name}'")
    result = []
    for line in path.read_text().splitlines():
        text = line if comments and not indent else line.partition('#')[0].rstrip()
        if text or (comments and not indent):
            result.append(indent + text)
        match = _FIELD.match(line)
        if match:
            inner, _, element = match.group(1).rpartition('/')
            result += lines(inner or package, 'msg', element, comments, indent + '\t')
    return result


def main(args: argparse.Namespace) -> None:
    """Print it."""
    parts = args.type.split('/')
    if len(parts) != 3 or parts[1] not in ('msg', 'srv', 'action'):
        raise CommandError(
            f"Invalid name '{args.type}'. Expected three parts separated by '/'")
    print('\n'.join(lines(parts[0], parts[1], parts[2], not args.no_comments)))
