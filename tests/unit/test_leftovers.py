# SPDX-License-Identifier: Apache-2.0
"""What of shared memory is removed when a node starts, and what is not."""
from __future__ import annotations

import fcntl
import mmap
import os
import time
from pathlib import Path

import pytest

from rocket_sim_node.wire import leftovers

SEGMENT = 'fastdds_0123456789abcdef'
PORT = 'fastdds_port9911'
GROUPS = {
    'segment': {SEGMENT, f'{SEGMENT}_el'},
    'port': {PORT, f'{PORT}_el', f'sem.{PORT}_mutex'},
    'shared port': {PORT, f'{PORT}_sl', f'sem.{PORT}_mutex'},
    'port that was only written to': {PORT, f'sem.{PORT}_mutex'},
    'semaphore of a port that is gone': {f'sem.{PORT}_mutex'},
    'port of an older Fast DDS': {'fastrtps_port7412', 'fastrtps_port7412_el'},
    'profile of who was killed while it started': {'hoverslam_0a1b2c.xml'},
}


def make(folder: Path, names: set[str], age: float = 60.0) -> None:
    """Make files that are some seconds old."""
    for name in names:
        (folder / name).write_bytes(bytes(mmap.PAGESIZE))
        then = time.time() - age
        os.utime(folder / name, (then, then))


def names(folder: Path) -> set[str]:
    """Return what is left."""
    return {file.name for file in folder.iterdir()}


@pytest.mark.parametrize('age', [60.0, -60.0], ids=['old', 'before the clock was set back'])
@pytest.mark.parametrize('group', GROUPS.values(), ids=GROUPS)
def test_what_the_dead_left_is_removed(tmp_path: Path, group: set[str], age: float) -> None:
    make(tmp_path, group, 2 * age)
    assert set(leftovers.clean(tmp_path)) == group
    assert not names(tmp_path)
    assert leftovers.clean(tmp_path) == []


@pytest.mark.parametrize('group', GROUPS.values(), ids=GROUPS)
def test_what_is_young_stays(tmp_path: Path, group: set[str]) -> None:
    make(tmp_path, group, age=0.0)
    assert leftovers.clean(tmp_path) == []
    # One file of them is enough.
    make(tmp_path, group)
    make(tmp_path, {sorted(group)[0]}, age=0.0)
    assert leftovers.clean(tmp_path) == []
    assert names(tmp_path) == group


@pytest.mark.parametrize('group', ['segment', 'port', 'shared port'])
@pytest.mark.parametrize('kind', [fcntl.LOCK_EX, fcntl.LOCK_SH])
def test_what_is_locked_stays_and_stays_locked(tmp_path: Path, group: str, kind: int) -> None:
    make(tmp_path, GROUPS[group])
    lock = next(tmp_path.glob('*_[es]l'))
    with lock.open('rb') as owner:
        fcntl.flock(owner, kind)
        assert leftovers.clean(tmp_path) == []
        assert names(tmp_path) == GROUPS[group]
        with lock.open('rb') as other, pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    assert set(leftovers.clean(tmp_path)) == GROUPS[group]


def test_what_a_process_has_mapped_stays(tmp_path: Path) -> None:
    group = GROUPS['port that was only written to']
    make(tmp_path, group)
    with (tmp_path / PORT).open('r+b') as file, mmap.mmap(file.fileno(), 0):
        assert leftovers.clean(tmp_path) == []
        assert names(tmp_path) == group
    assert set(leftovers.clean(tmp_path)) == group


def test_what_is_somebody_elses_stays(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    foreign = {'fastdds_notes', 'sem.other', 'fast_datasharing_1', f'{SEGMENT}0', 'fastdds_port'}
    make(tmp_path, foreign | GROUPS['segment'])
    user = os.geteuid()
    monkeypatch.setattr(os, 'geteuid', lambda: user + 1)
    assert leftovers.clean(tmp_path) == []
    monkeypatch.undo()
    assert set(leftovers.clean(tmp_path)) == GROUPS['segment']
    assert names(tmp_path) == foreign


def test_without_shared_memory_nothing_happens(tmp_path: Path) -> None:
    assert leftovers.clean(tmp_path / 'none') == []
