# SPDX-License-Identifier: Apache-2.0
"""Shared memory that is removed when a node starts, and that is not."""
from __future__ import annotations

import ctypes
import errno
import fcntl
import mmap
import os
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from rocket_sim_node.wire.dds import shared_memory_cleanup
from rocket_sim_node.wire.dds.semaphore import taken

SEGMENT = 'fastdds_0123456789abcdef'
PORT = 'fastdds_port41234'
SHARED = 'fastdds_port7003'
"""that any participant may take"""
GROUPS = {
    'segment': {SEGMENT, f'{SEGMENT}_el'},
    'port': {PORT, f'{PORT}_el', f'sem.{PORT}_mutex'},
    'shared port': {PORT, f'{PORT}_sl', f'sem.{PORT}_mutex'},
    'port that was only written to': {PORT, f'sem.{PORT}_mutex'},
    'semaphore of a port that is gone': {f'sem.{PORT}_mutex'},
    'port of an older Fast DDS': {
        'fastrtps_port41234', 'fastrtps_port41234_el', 'sem.fastrtps_port41234_mutex'},
    'profile of who was killed while it started': {'hoverslam_0a1b2c.xml'},
    'semaphore of who was killed while it made it': {'hoverslam_semaphore_0a1b2c'},
}


def make(folder: Path, names: set[str], age: float = 60.0) -> None:
    """Make files that are some seconds old; semaphores that nobody has."""
    for name in names:
        content = bytearray(32 if name.startswith('sem.') else mmap.PAGESIZE)
        if name.startswith('sem.'):
            semaphore = (ctypes.c_char * 32).from_buffer(content)
            assert ctypes.CDLL(None).sem_init(ctypes.byref(semaphore), 1, 1) == 0
        (folder / name).write_bytes(content)
        then = time.time() - age
        os.utime(folder / name, (then, then))


def names(folder: Path) -> set[str]:
    """Return what is left."""
    return {file.name for file in folder.iterdir()}


@pytest.mark.parametrize('age', [60.0, -60.0], ids=['old', 'before the clock was set back'])
@pytest.mark.parametrize('group', GROUPS.values(), ids=GROUPS)
def test_what_the_dead_left_is_removed(tmp_path: Path, group: set[str], age: float) -> None:
    make(tmp_path, group, 2 * age)
    assert set(shared_memory_cleanup.clean(tmp_path)) == group
    assert not names(tmp_path)
    assert shared_memory_cleanup.clean(tmp_path) == []


@pytest.mark.parametrize('group', GROUPS.values(), ids=GROUPS)
def test_what_is_young_stays(tmp_path: Path, group: set[str]) -> None:
    make(tmp_path, group, age=0.0)
    assert shared_memory_cleanup.clean(tmp_path) == []
    # One file of them is enough.
    make(tmp_path, group)
    make(tmp_path, {sorted(group)[0]}, age=0.0)
    assert shared_memory_cleanup.clean(tmp_path) == []
    assert names(tmp_path) == group


@pytest.mark.parametrize('group', ['segment', 'port', 'shared port'])
@pytest.mark.parametrize('kind', [fcntl.LOCK_EX, fcntl.LOCK_SH])
def test_what_is_locked_stays_and_stays_locked(tmp_path: Path, group: str, kind: int) -> None:
    make(tmp_path, GROUPS[group])
    lock = next(tmp_path.glob('*_[es]l'))
    with lock.open('rb') as owner:
        fcntl.flock(owner, kind)
        assert shared_memory_cleanup.clean(tmp_path) == []
        assert names(tmp_path) == GROUPS[group]
        with lock.open('rb') as other, pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    make(tmp_path, GROUPS[group])  # some file systems note that the semaphore was taken
    assert set(shared_memory_cleanup.clean(tmp_path)) == GROUPS[group]


def test_what_a_process_has_mapped_stays(tmp_path: Path) -> None:
    group = GROUPS['port that was only written to']
    make(tmp_path, group)
    with (tmp_path / PORT).open('r+b') as file, mmap.mmap(file.fileno(), 0):
        assert shared_memory_cleanup.clean(tmp_path) == []
        assert names(tmp_path) == group
    make(tmp_path, group)  # some file systems note that the semaphore was taken
    assert set(shared_memory_cleanup.clean(tmp_path)) == group


def test_what_is_somebody_elses_stays(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    foreign = {'fastdds_notes', 'sem.other', 'fast_datasharing_1', f'{SEGMENT}0', 'fastdds_port'}
    make(tmp_path, foreign | GROUPS['segment'])
    user = os.geteuid()
    monkeypatch.setattr(os, 'geteuid', lambda: user + 1)
    assert shared_memory_cleanup.clean(tmp_path) == []
    monkeypatch.undo()
    assert set(shared_memory_cleanup.clean(tmp_path)) == GROUPS['segment']
    assert names(tmp_path) == foreign


class Taker:
    """A participant of another program that takes a port, as Fast DDS does."""

    def __init__(self, folder: Path, port: str) -> None:
        self._semaphore, self._lock = folder / f'sem.{port}_mutex', folder / f'{port}_el'
        self._file = -1

    def takes(self) -> bool:
        """Lock the port for itself; false when it has to wait until somebody is done with it."""
        with taken(self._semaphore) as mine:
            if not mine:
                return False
            self._file = os.open(self._lock, os.O_RDONLY | os.O_CREAT)
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True

    def leave(self) -> None:
        """Give its lock back."""
        if self._file >= 0:
            os.close(self._file)


@pytest.mark.parametrize('port', [PORT, SHARED])
@pytest.mark.parametrize(('group', 'place'), [
    ('port', '_hold'), ('port', '_remove'), ('port that was only written to', '_hold'),
    ('port that was only written to', '_mapped'), ('port that was only written to', '_remove')])
def test_a_port_that_somebody_takes_meanwhile_is_not_touched(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, group: str, place: str, port: str,
) -> None:
    # Fast DDS uses an existing port again. Were it removed under it, nobody would reach it there,
    # at 7000 and up not even with what a participant is to know of its peers.
    there = {name.replace(PORT, port) for name in GROUPS[group]}
    make(tmp_path, there)
    taker = Taker(tmp_path, port)
    took = []
    real = getattr(shared_memory_cleanup, place)

    def come_first(*args: Any) -> Any:
        if place != '_remove' or any(port in file.name for file in args[0]):
            took.append(taker.takes())
        return real(*args)

    monkeypatch.setattr(shared_memory_cleanup, place, come_first)
    shared_memory_cleanup.clean(tmp_path)
    assert took == [place == '_hold']
    if took[0]:
        assert names(tmp_path) == {*there, f'{port}_el'}
    else:
        assert names(tmp_path) == ({f'sem.{port}_mutex'} if port == SHARED else set())
    taker.leave()


def test_a_port_that_was_removed_and_taken_meanwhile_stays(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    port = GROUPS['port'] - {f'sem.{PORT}_mutex'}
    make(tmp_path, port)
    flock = fcntl.flock
    owner = []

    def late(descriptor: int, kind: int) -> None:
        monkeypatch.undo()
        for name in port:
            (tmp_path / name).unlink()
        make(tmp_path, port)
        owner.append((tmp_path / f'{PORT}_el').open('rb'))
        flock(owner[0], fcntl.LOCK_EX)
        flock(descriptor, kind)  # of the file that was removed

    monkeypatch.setattr(fcntl, 'flock', late)
    with ExitStack() as stack:
        assert shared_memory_cleanup._lock([tmp_path / f'{PORT}_el'], stack) is False
    owner[0].close()


def age(file: Path) -> None:
    """Have it be old again: some file systems note that a semaphore was taken."""
    os.utime(file, (0, 0))


def test_the_semaphore_of_a_port_that_others_take_stays_unless_somebody_died_with_it(
        tmp_path: Path) -> None:
    semaphore = tmp_path / f'sem.{SHARED}_mutex'
    make(tmp_path, {SHARED, f'{SHARED}_el', semaphore.name})
    assert set(shared_memory_cleanup.clean(tmp_path)) == {SHARED, f'{SHARED}_el'}
    age(semaphore)
    assert shared_memory_cleanup.clean(tmp_path) == []
    make(tmp_path, {SHARED, f'{SHARED}_el'})
    with taken(semaphore) as free:
        assert free  # it was given back
        age(semaphore)
        # A process that has it, or waits for it, has it mapped, as this process has now.
        assert shared_memory_cleanup.clean(tmp_path) == []
        content = semaphore.read_bytes()
    semaphore.write_bytes(content)
    age(semaphore)
    assert shared_memory_cleanup.clean(tmp_path) == [semaphore.name]
    assert set(shared_memory_cleanup.clean(tmp_path)) == {SHARED, f'{SHARED}_el'}


def test_a_semaphore_that_is_taken_for_a_moment_is_not_stuck(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    semaphore = tmp_path / f'sem.{SHARED}_mutex'
    make(tmp_path, {SHARED, semaphore.name})
    mapped = shared_memory_cleanup._mapped
    with ExitStack() as somebody:
        assert somebody.enter_context(taken(semaphore))
        age(semaphore)

        def just_given_back(folder: Path) -> set[str]:
            somebody.close()
            age(semaphore)
            return mapped(folder)

        monkeypatch.setattr(shared_memory_cleanup, '_mapped', just_given_back)
        assert shared_memory_cleanup.clean(tmp_path) == []
    assert names(tmp_path) == {SHARED, semaphore.name}


def test_a_semaphore_is_that_of_the_c_library() -> None:
    name = f'/hoverslam_test_{os.getpid()}'
    library = ctypes.CDLL(None, use_errno=True)
    library.sem_open.restype = ctypes.c_void_p
    semaphore = ctypes.c_void_p(library.sem_open(name.encode(), os.O_CREAT, 0o600, 1))
    try:
        file = Path(f'/dev/shm/sem.{name[1:]}')
        with taken(file) as mine:
            assert mine
            assert library.sem_trywait(semaphore) != 0
        assert library.sem_trywait(semaphore) == 0
        with taken(file) as mine:
            assert not mine
        assert library.sem_post(semaphore) == 0
    finally:
        library.sem_unlink(name.encode())


def test_a_semaphore_that_was_removed_meanwhile_is_not_taken(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / f'sem.{PORT}_mutex'
    make(tmp_path, {file.name})
    lstat = Path.lstat

    def late(path: Path) -> os.stat_result:
        monkeypatch.undo()
        path.rename(tmp_path / 'gone')
        make(tmp_path, {file.name})
        return lstat(path)

    monkeypatch.setattr(Path, 'lstat', late)
    with pytest.raises(OSError, match='was replaced meanwhile'), taken(file):
        pass
    for there in (file, tmp_path / 'gone'):
        with taken(there) as mine:
            assert mine


@pytest.mark.parametrize('content', [b'', bytes(16)])
def test_what_is_no_semaphore_keeps_no_node_from_starting(tmp_path: Path, content: bytes) -> None:
    make(tmp_path, GROUPS['port'] | GROUPS['segment'])
    semaphore = tmp_path / f'sem.{PORT}_mutex'
    semaphore.write_bytes(content)
    age(semaphore)
    assert set(shared_memory_cleanup.clean(tmp_path)) == GROUPS['segment']


def test_more_than_are_looked_at_together(tmp_path: Path) -> None:
    ports = [f'fastdds_port{number}' for number in range(40000, 40200)]
    there = {*ports, *(f'sem.{port}_mutex' for port in ports)}
    make(tmp_path, there)
    assert set(shared_memory_cleanup.clean(tmp_path)) == there
    assert not names(tmp_path)


def test_a_port_without_a_semaphore_is_held_by_one_that_is_made(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make(tmp_path, {SHARED, f'{SHARED}_el'})
    taker = Taker(tmp_path, SHARED)
    took = []
    remove = shared_memory_cleanup._remove

    def come_first(files: list[Path]) -> list[str]:
        if files:
            took.append(taker.takes())
        return remove(files)

    monkeypatch.setattr(shared_memory_cleanup, '_remove', come_first)
    assert set(shared_memory_cleanup.clean(tmp_path)) == {SHARED, f'{SHARED}_el'}
    assert took == [False]
    assert names(tmp_path) == {f'sem.{SHARED}_mutex'}
    assert taker.takes()
    taker.leave()


def test_too_many_open_files_keep_no_node_from_starting(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: Any, **kinds: Any) -> Any:
        raise OSError(errno.EMFILE, 'Too many open files')

    make(tmp_path, GROUPS['port that was only written to'])
    monkeypatch.setattr(shared_memory_cleanup, '_mapped', refuse)
    assert shared_memory_cleanup.clean(tmp_path) == []
    monkeypatch.setattr(Path, 'iterdir', refuse)
    assert shared_memory_cleanup.clean(tmp_path) == []
    monkeypatch.undo()
    assert names(tmp_path) == GROUPS['port that was only written to']


def test_without_shared_memory_nothing_happens(tmp_path: Path) -> None:
    assert shared_memory_cleanup.clean(tmp_path / 'none') == []
