# SPDX-License-Identifier: Apache-2.0
"""The arguments that a launch file declares: names, defaults and descriptions."""
from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from rocket_sim_node.command_line import read_value

_LOADER: Any = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
_SUBSTITUTION = re.compile(r'\$\((?:dirname|var (\w+))\)')


@dataclass(frozen=True)
class LaunchArgument:
    """One argument; `default` is None where there is none."""

    name: str
    default: str | None
    description: str

    @property
    def is_path(self) -> bool:
        """Whether the default names a file."""
        return bool(self.default and _SUBSTITUTION.search(self.default))

    def check(self, value: str) -> None:
        """Check that a value is of the default's kind.

        :raises ValueError: naming the argument.
        """
        default = self.default or ''
        if default in ('true', 'false'):
            if value not in ('true', 'false'):
                raise ValueError(f'{self.name}: got {value!r}, expected true or false')
        elif re.fullmatch(r'\d+', default):
            least = int(self.name == 'num_envs')
            if not re.fullmatch(r'\d+', value) or int(value) < least:
                raise ValueError(
                    f'{self.name}: got {value!r}, expected a whole number from {least}')
        elif re.fullmatch(r'\d+\.\d*', default):
            number = read_value(value, 0.0)
            if not isinstance(number, int | float) or not math.isfinite(number):
                raise ValueError(f'{self.name}: got {value!r}, expected a number')


def read_launch_file(path: Path) -> dict[str, LaunchArgument]:
    """Return the arguments that a launch file declares, by name.

    :raises OSError: when it cannot be read.
    """
    entries = yaml.load(path.read_text('utf-8'), _LOADER)['launch']  # a kind of safe loader
    found = (entry['arg'] for entry in entries if 'arg' in entry)
    return {
        each['name']: LaunchArgument(each['name'], each.get('default'), each['description'])
        for each in found}


def resolved(
    declared: Mapping[str, LaunchArgument], given: Mapping[str, str], folder: Path,
) -> dict[str, str]:
    """Return the value of each argument: the one given, or else its default.

    :param folder: that the launch file lies in.
    """
    values: dict[str, str] = {}
    for name, argument in declared.items():
        values[name] = given.get(name) or _SUBSTITUTION.sub(
            lambda match: values[match[1]] if match[1] else str(folder), argument.default or '')
    return values
