# SPDX-License-Identifier: Apache-2.0
"""Context of a launch file that is carried out, and the error that names a place in it."""
from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
from pathlib import Path

from ros2.errors import FULL
from ros2.errors import CommandError


class LaunchError(CommandError):
    """Something in a launch file that cannot be carried out; `placed` when the text says where."""

    def __init__(self, text: str, placed: bool = False) -> None:
        """Keep both."""
        super().__init__(text)
        self.placed = placed


@dataclass
class Context:
    """State of a launch: arguments by name, the folder of its logs, where we are."""

    arguments: dict[str, str]
    log_dir: Path
    file: Path = field(default_factory=Path)
    namespace: str = ''

    def inner(self) -> Context:
        """Return a copy for a scope whose changes end with it."""
        return Context(dict(self.arguments), self.log_dir, self.file, self.namespace)


def join_namespaces(base: str, namespace: str) -> str:
    """Return `namespace` below `base`, absolute; an absolute one stands alone."""
    if namespace in ('', '/'):
        joined = base
    elif namespace.startswith('/') or not base:
        joined = namespace
    else:
        joined = f'{base.rstrip("/")}/{namespace}'
    if not joined:
        return ''
    return '/' + joined.strip('/')


def parse_arguments(texts: list[str]) -> dict[str, str]:
    """Return launch arguments by name; of several for one name the last wins.

    :raises CommandError: when one is not of the form NAME:=VALUE, or has a meaning of its own.
    """
    result: dict[str, str] = {}
    for text in texts:
        name, separator, value = text.partition(':=')
        if not name or not separator or (not value and text.count(':=') == 1):
            # The real command refuses an empty value, too.
            raise CommandError(
                f"malformed launch argument '{text}', expected format '<name>:=<value>'")
        if name.startswith('launch-prefix'):
            raise CommandError(f"launch argument '{name}' is not supported here; {FULL}")
        result[name] = value
    return result
