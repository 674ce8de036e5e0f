# SPDX-License-Identifier: Apache-2.0
"""Folder of a run of several ranks: rank 0 has it, the others a temporary copy."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from contextlib import ExitStack
from contextlib import contextmanager
from contextlib import suppress
from pathlib import Path

from ppo_agent_node.distributed.errors import RankLost
from ppo_agent_node.distributed.ranks import Ranks
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.runs.folder import RunFolderError
from rocket_sim_node.scratch_folder import scratch_folder


@contextmanager
def open_folder(
    path: Path, resume: bool, ranks: Ranks, poll: Callable[[], None] = lambda: None,
) -> Iterator[RunFolder]:
    """Open and lock a run's folder on rank 0; on the others a copy, removed at the end.

    The ranks need no common file system. A resumed run may have another number of ranks.

    :param poll: called while waiting for rank 0; may raise.
    :raises OSError: on all ranks, if rank 0 cannot use the folder.
    :raises RankLost: when another rank is gone.
    """
    if ranks.first:
        with ExitStack() as stack:
            try:
                folder = RunFolder(path, resume)
                stack.enter_context(folder.locked())
                files = _files(folder) if ranks.count > 1 else {}
            except OSError as error:
                with suppress(RankLost):
                    ranks.main.of_first(str(error), poll)
                raise
            try:
                ranks.main.of_first(files, poll)
            except BaseException:
                folder.withdraw()
                raise
            yield folder
        return
    with scratch_folder() as scratch:
        copy = scratch / 'run'
        received: dict[str, bytes] | str = ranks.main.of_first({}, poll)
        if isinstance(received, str):
            raise RunFolderError(f'rank 0: {received}')
        for name, content in received.items():
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
