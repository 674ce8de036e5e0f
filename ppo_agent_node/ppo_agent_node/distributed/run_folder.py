# SPDX-License-Identifier: Apache-2.0
"""Folder of a run of several ranks: rank 0 has it, the others a temporary copy."""
from __future__ import annotations

import tempfile
from collections.abc import Callable
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ppo_agent_node.distributed.errors import RankLost
from ppo_agent_node.distributed.ranks import Ranks
from ppo_agent_node.runs.folder import RunFolder


@contextmanager
def open_folder(
    path: Path, resume: bool, ranks: Ranks, poll: Callable[[], None] = lambda: None,
) -> Iterator[RunFolder]:
    """Open and lock a run's folder on rank 0; on the others a copy, removed at the end.

    The ranks need no common file system. A resumed run may have another number of ranks.

    :param poll: called while waiting for rank 0; may raise.
    :raises RunFolderError: on rank 0, as `RunFolder` does.
    :raises RankLost: when another rank is gone.
    """
    if ranks.first:
        folder = RunFolder(path, resume)
        with folder.locked():
            try:
                ranks.main.of_first(_files(folder) if ranks.count > 1 else {}, poll)
            except RankLost:
                folder.withdraw()
                raise
            yield folder
        return
    with tempfile.TemporaryDirectory(prefix='hoverslam-rank-') as scratch:
        copy = Path(scratch) / 'run'
        files: dict[str, bytes] = ranks.main.of_first({}, poll)
        for name, content in files.items():
            target = copy / name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)
        folder = RunFolder(copy, resume=True)
        with folder.locked():
            yield folder


def _files(folder: RunFolder) -> dict[str, bytes]:
    """Return what a run is resumed from, by path within the folder."""
    paths = [folder.config, folder.log, *folder.checkpoints.glob('*.safetensors')]
    return {
        str(path.relative_to(folder.path)): path.read_bytes() for path in paths if path.exists()}
