# SPDX-License-Identifier: Apache-2.0
"""Interfaces: their definitions."""
from __future__ import annotations

import argparse
import re

from ros2 import packages
from ros2.errors import CommandError
from ros2.verb import Verb

_FIELD = re.compile(r'\s*((?:\w+/)?[A-Z]\w*)(?:\[[^\]]*\])?\s+\w')


def lines(package: str, kind: str, name: str, indent: str = '') -> list[str]:
    """Return the definition, that of nested messages below their field, further in.

    :raises CommandError: when there is no such interface.
    """
    path = packages.share_of(package) / kind / f'{name}.{kind}'
    if not path.is_file():
        raise CommandError(f"Could not find the interface '{package}/{kind}/{name}'")
    result = []
    for line in path.read_text().splitlines():
        text = line.partition('#')[0].rstrip() if indent else line
        if text or not indent:
            result.append(indent + text)
        match = _FIELD.match(line)
        if match:
            inner, _, element = match.group(1).rpartition('/')
            result += lines(inner or package, 'msg', element, indent + '\t')
    return result


def show(args: argparse.Namespace) -> None:
    """Print it."""
    parts = args.type.split('/')
    if len(parts) != 3 or parts[1] not in ('msg', 'srv', 'action'):
        raise CommandError(
            f"Invalid name '{args.type}'. Expected three parts separated by '/'")
    print('\n'.join(lines(*parts)))


VERBS = {
    'show': Verb('Output the interface definition', show, {
        'type': {'help': 'Show an interface definition (e.g. "std_msgs/msg/String")'}}),
}
