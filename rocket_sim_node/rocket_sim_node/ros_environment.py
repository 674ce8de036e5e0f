# SPDX-License-Identifier: Apache-2.0
"""Checks of the environment that ROS 2 itself makes late, or without naming the reason."""
from __future__ import annotations

import os
import re
import shutil
from collections.abc import Mapping
from collections.abc import MutableMapping
from pathlib import Path

from rocket_sim_node.printable import printable

_HIGHEST_DOMAIN = 232
"""of DDS on UDP, whose ports end at 65535 (RTPS 2.2, 9.6.1.1)"""
_SHARED_MEMORY = Path('/dev/shm')
_ROOM = 64 * 1024
"""Bytes. The tracing library of ROS 2 maps two pages for each user; where none is left, the system
ends each node with SIGBUS as it loads that library."""
_DISCOVERY = (
    'ROS_DISCOVERY_SERVER', 'ROS_STATIC_PEERS', 'ROS_AUTOMATIC_DISCOVERY_RANGE',
    'ROS_LOCALHOST_ONLY', 'ROS2_EASY_MODE')
"""Variables, beside the domain, that decide which other nodes a node finds."""
_LONGEST = 100
"""Maximum characters of a value in a message."""
_LOGS = ('HOME', 'ROS_HOME', 'ROS_LOG_DIR')


NAME = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')
"""one part of the name of a node, topic or namespace"""
LONGEST_NAMESPACE = 150
"""characters; names of topics and services follow it"""


def check_name(setting: str, name: str) -> None:
    """Check a setting that is one part of a namespace.

    :raises ValueError: naming the setting, its value and what was expected.
    """
    if not NAME.fullmatch(name) or len(name) > LONGEST_NAMESPACE:
        raise ValueError(
            f'{setting}: got {name!r}, expected a word of letters, digits and _ that does not '
            f'begin with a digit, {LONGEST_NAMESPACE} characters at most')


def check(environ: Mapping[str, str]) -> None:
    """Check variables that nodes read.

    :raises ValueError: naming the variable, its value and what was expected.
    """
    domain = environ.get('ROS_DOMAIN_ID', '')
    if domain and not (re.fullmatch('[0-9]{1,9}', domain) and int(domain) <= _HIGHEST_DOMAIN):
        raise ValueError(
            f'ROS_DOMAIN_ID: got {domain!r}, expected a whole number from 0 to {_HIGHEST_DOMAIN}')


def advice(environ: Mapping[str, str], *, several: bool = False) -> str:
    """Return what to compare in the environments of two nodes that do not find each other.

    :param several: whether more than one node is missing.
    """
    found = ', '.join(
        f'{name}={printable(environ[name]):.{_LONGEST}}'
        for name in _DISCOVERY if environ.get(name))
    return (f'{"are they" if several else "is it"} running, '
            'with the same ROS_DOMAIN_ID and namespace?'
            + (f' Here {found}, which also decides what is found' if found else ''))


def check_shared_memory(folder: Path = _SHARED_MEMORY) -> None:
    """Check that nodes can start with the room that is left in shared memory.

    :raises OSError: naming the folder, the room and what was expected.
    """
    if not os.access(folder, os.W_OK):  # nothing is mapped there
        return
    free = shutil.disk_usage(folder).free
    if free < _ROOM:
        raise OSError(
            f'{folder}: got {free >> 10} KiB free, expected {_ROOM >> 10} or more; ROS 2 would '
            'crash as it starts')


def complete(environ: MutableMapping[str, str]) -> None:
    """Set HOME where nothing says in which folder ROS 2 keeps its logs.

    :raises ValueError: when the system knows no home of this user either.
    """
    if any(environ.get(name) for name in _LOGS):
        return
    environ.pop('HOME', None)
    home = os.path.expanduser('~')
    if home == '~':
        raise ValueError('HOME: got none, expected a folder; ROS 2 keeps its logs there')
    environ['HOME'] = home
