# SPDX-License-Identifier: Apache-2.0
"""Commit of the sources that run, where they are those of a git repository."""
from __future__ import annotations

import functools
import os
import subprocess
from pathlib import Path

_HERE = Path(__file__)
_SECONDS = 10.0


@functools.cache
def source_commit() -> str:
    """Return the commit, with `-dirty` for changed sources; empty where it is not known."""
    # A package installed into another project's repository is not of that project's commit.
    if not _git('ls-files', '--error-unmatch', _HERE.name):
        return ''
    return _git('describe', '--always', '--dirty', '--abbrev=7')


def _git(*arguments: str) -> str:
    """Return what git says, empty where it fails or is missing."""
    # A hook, or `git rebase --exec`, may have named another repository in the environment.
    environment = {name: text for name, text in os.environ.items() if not name.startswith('GIT_')}
    try:
        done = subprocess.run(
            ['git', '-C', str(_HERE.parent), *arguments], capture_output=True, text=True,
            check=False, timeout=_SECONDS, env=environment)
    except (OSError, subprocess.TimeoutExpired):
        return ''
    return done.stdout.strip() if done.returncode == 0 else ''
