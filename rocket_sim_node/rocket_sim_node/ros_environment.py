# SPDX-License-Identifier: Apache-2.0
"""Environment variables that ROS 2 would refuse late, with errors that do not name them."""
from __future__ import annotations

import os
import re
from collections.abc import Mapping
from collections.abc import MutableMapping

_HIGHEST_DOMAIN = 232
"""of DDS on UDP, whose ports end at 65535 (RTPS 2.2, 9.6.1.1)"""
_LOGS = ('HOME', 'ROS_HOME', 'ROS_LOG_DIR')


def check(environ: Mapping[str, str]) -> None:
    """Check variables that nodes read.

    :raises ValueError: naming the variable, its value and what was expected.
    """
    domain = environ.get('ROS_DOMAIN_ID', '')
    if domain and not (re.fullmatch('[0-9]{1,9}', domain) and int(domain) <= _HIGHEST_DOMAIN):
        raise ValueError(
            f'ROS_DOMAIN_ID: got {domain!r}, expected a whole number from 0 to {_HIGHEST_DOMAIN}')


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
