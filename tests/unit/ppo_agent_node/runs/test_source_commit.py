# SPDX-License-Identifier: Apache-2.0
"""The commit that a run notes is that of its own sources."""
from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from ppo_agent_node.runs import source_commit as module


@pytest.mark.skipif(not shutil.which('git'), reason='needs git')
def test_another_repository_named_in_the_environment_is_ignored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    ours = module.source_commit.__wrapped__()
    (tmp_path / 'source_commit.py').touch()
    for arguments in (('init', '-q'), ('add', '.'), (
            '-c', 'user.name=x', '-c', 'user.email=x', 'commit', '-q', '-m', 'theirs')):
        subprocess.run(['git', '-C', str(tmp_path), *arguments], check=True, timeout=30)
    monkeypatch.setenv('GIT_DIR', str(tmp_path / '.git'))
    assert module.source_commit.__wrapped__() == ours
