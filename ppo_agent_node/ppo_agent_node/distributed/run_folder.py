# SPDX-License-Identifier: Apache-2.0
"""Folder of a run of several ranks: rank 0 has it, the others a temporary copy."""
from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ppo_agent_node.distributed.ranks import Ranks
from ppo_agent_node.runs.folder import RunFolder


@contextmanager
def open_folder(path: Path, resume: bool, ranks: Ranks) -> Iterator[RunFolder]:
    """Open and lock a run's folder on rank 0; on the others a copy, removed at the end.

    The ranks need no common file system. A resumed run may have any number of ranks.

    :raises RunFolderError: on rank 0, as `RunFolder` does.
    """
    if ranks.first:
        folder = RunFolder(path, resume)
        with folder.locked():
            if ranks.count > 1:
                ranks.main.gather(_files(folder))
            yield folder
        return
    with tempfile.TemporaryDirectory(prefix='hoverslam-rank-') as scratch:
        copy = Path(scratch) / path.name
        files: dict[str, bytes] = ranks.main.gather({})[0]
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
