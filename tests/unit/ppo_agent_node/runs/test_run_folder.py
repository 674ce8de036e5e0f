# SPDX-License-Identifier: Apache-2.0
"""The folder of a run: its log, its checkpoints, and what can be wrong with it."""
from __future__ import annotations

import errno
import math
import os
from pathlib import Path

import pytest
import torch

from ppo_agent_node import atomic_file
from ppo_agent_node.runs import folder as folder_module
from ppo_agent_node.runs import run_lock
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.runs.folder import RunFolderError
from ppo_agent_node.runs.train_log import read_log
from rocket_sim_node import input_file


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return RunFolder(tmp_path / 'runs' / 'one')


def save(folder: RunFolder, *iterations: int) -> None:
    for iteration in iterations:
        folder.save(iteration, {'x': torch.tensor([iteration])}, {'iteration': iteration})


def test_the_newest_two_checkpoints_are_kept(folder: RunFolder) -> None:
    save(folder, 0, 5, 10, 1_000_000)
    folder.save_best({}, {})
    assert sorted(p.name for p in folder.checkpoints.iterdir()) == [
        'best.safetensors', 'iteration_000010.safetensors', 'iteration_1000000.safetensors']
    found = folder.newest(pytest.fail)
    assert found is not None
    assert found[1].content == {'iteration': 1_000_000}


def test_a_damaged_checkpoint_falls_back_to_the_one_before(folder: RunFolder) -> None:
    assert folder.newest(pytest.fail) is None
    save(folder, 5, 10)
    newest = folder.checkpoints / 'iteration_000010.safetensors'
    newest.write_bytes(newest.read_bytes()[:-3])
    said: list[str] = []
    found = folder.newest(said.append)
    assert found is not None
    assert found[1].content == {'iteration': 5}
    assert len(said) == 1
    assert 'iteration_000010.safetensors: damaged' in said[0]
    (folder.checkpoints / 'iteration_000005.safetensors').write_bytes(b'')
    with pytest.raises(ValueError, match='all 2 checkpoints are damaged'):
        folder.newest(said.append)


def test_a_damaged_checkpoint_is_renamed_when_the_run_continues(folder: RunFolder) -> None:
    save(folder, 15)
    save(folder, 20)
    newer = folder.checkpoints / 'iteration_000020.safetensors'
    whole = newer.read_bytes()
    newer.write_bytes(whole[:-1])
    found = folder.newest(lambda text: None)
    assert found is not None
    folder.go_on_from(found[0])
    assert newer.with_suffix('.damaged').read_bytes() == whole[:-1]
    save(folder, 16)
    newest = folder.newest(pytest.fail)
    assert newest is not None and newest[0].stem == 'iteration_000016'
    folder.go_on_from(newest[0])
    assert newest[0].exists()


def test_log(folder: RunFolder) -> None:
    for iteration in range(4):
        folder.append({'iteration': iteration, 'value': 0.1 + iteration, 'none': float('nan')})
    assert folder.lines()[3] == {'iteration': 3, 'value': 3.1, 'none': None}
    assert folder.append({'list': [1.0, math.inf], 'by name': {'a': math.nan}}) == {
        'list': [1.0, None], 'by name': {'a': None}}
    folder.cut_log(4)
    with folder.log.open('a') as file:
        file.write('{"iteration": 4, "val')  # the power went
    assert len(folder.lines()) == 4
    folder.cut_log(2)
    assert [line['iteration'] for line in folder.lines()] == [0, 1]
    folder.append({'iteration': 2})
    assert len(folder.lines()) == 3
    with pytest.raises(ValueError, match=r'train\.jsonl: has 3 lines, expected at least 7'):
        folder.cut_log(7)
    folder.log.write_text('{"a": 1}\nnonsense\n{"a": 2}\n')
    with pytest.raises(ValueError, match=r'train\.jsonl: line 2 is damaged'):
        folder.lines()
    assert read_log(folder.path / 'missing.jsonl') == []


def test_config(folder: RunFolder) -> None:
    assert folder.read_config() == {}
    folder.write_config({'seed': 1, 'hidden_sizes': (256, 256), 'name': 'x', 'gamma': 1.0})
    assert folder.read_config() == {
        'seed': 1, 'hidden_sizes': [256, 256], 'name': 'x', 'gamma': 1.0}
    for damaged in ('a: [', 'just words', '\x00'):
        folder.config.write_text(damaged)
        with pytest.raises(ValueError, match=r'config\.yaml: damaged'):
            folder.read_config()


def test_an_existing_run_is_not_overwritten(folder: RunFolder) -> None:
    RunFolder(folder.path)  # nothing was written yet
    folder.cut_log(0)
    assert not RunFolder(folder.path).begun, 'the log is created just before the settings'
    folder.append({})
    with pytest.raises(RunFolderError, match=r'runs/one: already holds a run'):
        RunFolder(folder.path)
    assert RunFolder(folder.path, resume=True).lines() == [{}]


def test_folders_that_cannot_be_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(RunFolderError, match=r'file/run: not writable: Not a directory'):
        RunFolder(tmp_path / 'file' / 'run')

    def refuse(dir: Path) -> None:
        raise PermissionError(errno.EACCES, 'Permission denied')

    monkeypatch.setattr(folder_module.tempfile, 'TemporaryFile', refuse)
    with pytest.raises(RunFolderError, match='run: not writable: Permission denied'):
        RunFolder(tmp_path / 'run')


def test_a_full_disk_is_named(folder: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    save(folder, 1)

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr(atomic_file.os, 'fsync', full)
    with pytest.raises(OSError, match=r'No space left.*iteration_000002'):
        save(folder, 2)
    found = folder.newest(pytest.fail)
    assert found is not None
    assert found[1].content == {'iteration': 1}
    assert RunFolder(folder.path, resume=True)


@pytest.mark.skipif(not Path('/dev/full').exists(), reason='needs a device that is always full')
def test_a_log_on_a_full_disk_is_named(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        input_file, 'open_in_place', lambda path, flags: os.open('/dev/full', flags))
    with pytest.raises(OSError, match=r'No space left.*train\.jsonl'):
        folder.append({'iteration': 1})


@pytest.mark.parametrize('kind', ['FIFO', 'symbolic link'])
@pytest.mark.parametrize('name', ['.lock', '.unfinished', 'train.jsonl'])
def test_fifos_and_symbolic_links_in_a_run_are_refused(
    folder: RunFolder, tmp_path: Path, name: str, kind: str,
) -> None:
    theirs, path = tmp_path / 'theirs', folder.path / name
    theirs.write_text('precious')
    if kind == 'FIFO':
        os.mkfifo(path)
    else:
        path.symlink_to(theirs)
    assert not run_lock.in_use(folder.path)
    with pytest.raises(OSError, match=f'got a {kind}, expected a regular file') as refused:
        with folder.locked():
            folder.mark_unfinished()
            folder.append({'iteration': 1})
    assert str(path) in str(refused.value)
    assert theirs.read_text() == 'precious'


def test_a_run_that_never_began_removes_its_folder(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / 'new')
    with folder.locked():
        folder.mark_unfinished()
        folder.withdraw()
    assert not folder.path.exists()


def test_a_run_has_finished_when_it_has_begun_and_nothing_is_to_be_resumed(
    folder: RunFolder,
) -> None:
    assert not folder.finished
    folder.mark_unfinished()
    folder.write_config({})
    save(folder, 1)
    assert not folder.finished
    folder.mark_finished()
    assert folder.finished


def test_a_withdrawal_keeps_user_files_and_runs_that_have_begun(tmp_path: Path) -> None:
    (tmp_path / 'notes').write_text('mine')
    RunFolder(tmp_path).withdraw()
    assert [path.name for path in tmp_path.iterdir()] == ['notes']
    begun = RunFolder(tmp_path / 'begun')
    begun.append({'iteration': 0})
    begun.withdraw()
    assert begun.log.exists()
    assert begun.checkpoints.exists()
