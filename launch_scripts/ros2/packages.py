# SPDX-License-Identifier: Apache-2.0
"""Packages and their executables, found through the ament index."""
from __future__ import annotations

import os
from pathlib import Path

from ros2.errors import CommandError

_MARKERS = Path('share/ament_index/resource_index/packages')


class PackageNotFoundError(CommandError):
    """No prefix in AMENT_PREFIX_PATH has such a package."""

    def __init__(self, name: str) -> None:
        """Say it in the words of the real command."""
        super().__init__(f"Package '{name}' not found")


def prefixes() -> list[Path]:
    """Return the folders of AMENT_PREFIX_PATH, the first to win first.

    :raises CommandError: when it is not set.
    """
    value = os.environ.get('AMENT_PREFIX_PATH', '')
    if not value:
        raise CommandError(
            "Environment variable 'AMENT_PREFIX_PATH' is not set or empty; "
            'enter the environment first: . launch_scripts/env.sh')
    return [Path(part) for part in value.split(os.pathsep) if part]


def names() -> list[str]:
    """Return the names of all packages, sorted."""
    folders = [prefix / _MARKERS for prefix in prefixes()]
    return sorted({
        entry.name for folder in folders if folder.is_dir()
        for entry in folder.iterdir() if not entry.name.startswith('.')})


def prefix_of(name: str) -> Path:
    """Return the prefix that a package is installed in.

    :raises PackageNotFoundError: when there is none.
    """
    for prefix in prefixes():
        if name and (prefix / _MARKERS / name).is_file():
            return prefix
    raise PackageNotFoundError(name)


def share_of(name: str) -> Path:
    """Return the share folder of a package.

    :raises PackageNotFoundError: when there is no such package.
    """
    return prefix_of(name) / 'share' / name


def executables_of(name: str) -> list[Path]:
    """Return the executables of a package, sorted.

    :raises PackageNotFoundError: when there is no such package.
    """
    folder = prefix_of(name) / 'lib' / name
    return sorted(
        path for path in folder.rglob('*')
        if not any(part.startswith('.') for part in path.relative_to(folder).parts)
        and path.is_file() and os.access(path, os.X_OK))


def executable(package: str, name: str) -> Path:
    """Return the one executable of that name.

    :raises CommandError: when the package, or the executable, or a single one, is missing.
    """
    matches = [path for path in executables_of(package) if path.name == name]
    if not matches:
        raise CommandError('No executable found')
    if len(matches) > 1:
        raise CommandError('\n- '.join(['Multiple executables found:', *map(str, matches)]))
    return matches[0]
