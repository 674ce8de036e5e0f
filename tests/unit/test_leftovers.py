# SPDX-License-Identifier: Apache-2.0
"""What of shared memory is removed when a node starts, and what is not."""
from __future__ import annotations

import fcntl
import mmap
import os
import time
from collections.abc import Iterator
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


class Taker:
    """A participant of another program that takes a port, as Fast DDS does."""

    def __init__(self, folder: Path) -> None:
        self._lock = folder / f'{PORT}_el'
        self._files: list[int] = []

    def takes(self) -> bool:
        """Lock the port for itself; false when it has to go on to the next one."""
        file = os.open(self._lock, os.O_RDONLY | os.O_CREAT)
        self._files.append(file)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def leave(self) -> None:
        """Give its locks back."""
        while self._files:
            os.close(self._files.pop())


@pytest.fixture
def taker(tmp_path: Path) -> Iterator[Taker]:
    somebody = Taker(tmp_path)
    yield somebody
    somebody.leave()


@pytest.mark.parametrize(('group', 'look'), [
    ('port', 1),
    *((group, look) for group in (
        'port that was only written to', 'semaphore of a port that is gone')
      for look in (1, 2, 3))])
def test_a_port_that_somebody_takes_meanwhile_stays_or_is_refused(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, taker: Taker, group: str, look: int,
) -> None:
    # Fast DDS uses an existing port again. Were it removed under it, nobody would reach it there,
    # at 7000 and up not even with what a participant is to know of its peers.
    make(tmp_path, GROUPS[group])
    looks, took = 0, False
    mapped, remove = leftovers._mapped, leftovers._remove

    def come() -> None:
        nonlocal looks, took
        looks += 1
        if looks == look:
            took = taker.takes()

    def look_who_has_it_mapped(folder: Path) -> set[str]:
        come()
        return mapped(folder)

    def remove_it(files: list[Path]) -> list[str]:
        if GROUPS[group] <= {file.name for file in files}:
            come()
        return remove(files)

    monkeypatch.setattr(leftovers, '_mapped', look_who_has_it_mapped)
    monkeypatch.setattr(leftovers, '_remove', remove_it)
    leftovers.clean(tmp_path)
    assert looks >= look
    assert took == (look == 1 and group != 'port')
    assert names(tmp_path) == ({*GROUPS[group], f'{PORT}_el'} if took else set())


@pytest.mark.parametrize('group', GROUPS)
def test_locks_are_held_until_all_else_is_gone(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, group: str) -> None:
    make(tmp_path, GROUPS[group])
    unlink = Path.unlink

    def watched(file: Path) -> None:
        if group == 'profile of who was killed while it started':
            return unlink(file)
        if not file.name.endswith(('_el', '_sl')):
            assert any(name.endswith(('_el', '_sl')) for name in names(tmp_path))
        else:
            assert all(name.endswith(('_el', '_sl')) for name in names(tmp_path))
        for lock in tmp_path.glob('*_[es]l'):
            with lock.open('rb') as other, pytest.raises(BlockingIOError):
                fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return unlink(file)

    monkeypatch.setattr(Path, 'unlink', watched)
    assert set(leftovers.clean(tmp_path)) == GROUPS[group]
    assert not names(tmp_path)


def test_a_port_that_was_removed_and_taken_meanwhile_stays(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, taker: Taker) -> None:
    make(tmp_path, GROUPS['port'])
    flock = fcntl.flock

    def late(descriptor: int, kind: int) -> None:
        monkeypatch.undo()
        for name in GROUPS['port']:
            (tmp_path / name).unlink()
        make(tmp_path, {PORT, f'sem.{PORT}_mutex'}, age=0.0)
        assert taker.takes()
        flock(descriptor, kind)  # of the file that was removed

    monkeypatch.setattr(fcntl, 'flock', late)
    assert leftovers.clean(tmp_path) == []
    assert names(tmp_path) == GROUPS['port']


def test_more_ports_than_are_looked_at_together(tmp_path: Path) -> None:
    ports = {f'sem.fastdds_port{number}_mutex' for number in range(7000, 7200)}
    make(tmp_path, ports)
    assert set(leftovers.clean(tmp_path)) == ports
    assert not names(tmp_path)


def test_without_shared_memory_nothing_happens(tmp_path: Path) -> None:
    assert leftovers.clean(tmp_path / 'none') == []
