# SPDX-License-Identifier: Apache-2.0
"""Writes that fail or are cut short, at any of them; and clocks that are set back."""
from __future__ import annotations

import errno
import math
import os
import random
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from support.machine.disks import writers
from support.training.line_world import LineWorld
from support.processes import wait_until
from support.training.training_runs import log_without_times

from ppo_agent_node.config.training_config import make_config
from ppo_agent_node.runs import tensor_file
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.runs.new_paths import new_folder
from rocket_sim_node.telemetry.training_status import Status
from ppo_agent_node.training.trainer import Trainer
from rocket_sim_node.worlds.jobs import SerialFleet

SEED = 6


SMALL: dict[str, Any] = {
    'demonstration_episodes': 0, 'curriculum_start_level': 0, 'curriculum_final_level': 0,
    'hidden_sizes': (16,), 'fine_observations': '', 'iterations': 4, 'n_steps': 32,
    'scatter_steps': 0, 'batch_size': 64, 'gamma': 0.97, 'actor_learning_rate': 1e-2,
    'critic_learning_rate': 1e-2, 'critic_warmup_iterations': 0, 'reward_scale': 0.1,
    'threads': 1, 'checkpoint_interval': 2, 'selection_interval': 1, 'selection_episodes': 8}


def train(run: Path) -> list[Status]:
    """Start or continue a small run; return its reports."""
    statuses: list[Status] = []
    with (folder := RunFolder(run, resume=True)).locked():
        assert Trainer(
            SerialFleet(LineWorld()), make_config(SMALL), folder, statuses.append).run().finished
    return statuses


def learnt(run: Path) -> dict[str, Any]:
    """Return all that a run leaves, but for times."""
    files = {}
    for path in run.rglob('*.safetensors'):
        tensors, content = tensor_file.read(
            path, 'checkpoint' if path.parent.name == 'checkpoints' else 'policy')
        files[path.name] = content, {name: t.numpy().tobytes() for name, t in tensors.items()}
    return {**files, 'log': log_without_times(run)}


@pytest.fixture(scope='module')
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    run = tmp_path_factory.mktemp('undisturbed') / 'run'
    train(run)
    return learnt(run)


@pytest.mark.slow
def test_a_writer_killed_at_any_moment_leaves_whole_checkpoints(
        tmp_path: Path, nightly: bool) -> None:
    moments = random.Random(SEED)
    path, newest, said = tmp_path / 'run', -1, list[str]()
    folder = RunFolder(path)

    def written() -> int:
        return max((int(p.stem[10:]) for p in folder.checkpoints.glob('iteration_*')), default=-1)

    with writers(path) as several:
        for number in range(200 if nightly else 20):
            several.start(newest + 1)
            wait_until(lambda least=newest: written() > least, 60.0)  # type: ignore[misc]
            time.sleep(moments.uniform(0.0, 0.1))
            several.kill()
            found = folder.newest(said.append)
            assert found is not None
            assert not said, f'seed {SEED}, kill {number}: {said}'
            saved = found[1].content['iteration']
            assert saved > newest, f'seed {SEED}, kill {number}'
            assert found[0].stem == f'iteration_{saved:06d}'
            assert (found[1].tensors['a'] == saved).all()
            best = tensor_file.read(folder.best, 'checkpoint').content['iteration']
            assert best in (saved, saved + 1), f'seed {SEED}, kill {number}'
            folder.cut_log(saved + 1)
            assert [line['iteration'] for line in folder.lines()] == list(range(saved + 1))
            newest = saved
    with folder.locked():
        assert not list(path.rglob('*.part')), 'leftovers of the dead'


@pytest.mark.slow
def test_a_disk_full_at_any_write_costs_nothing_that_is_learnt(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, undisturbed: dict[str, Any],
        nightly: bool) -> None:
    real, written, full_from = os.fsync, 0, math.inf

    def fsync(file: int) -> None:
        nonlocal written
        written += 1
        if written >= full_from:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(file)

    monkeypatch.setattr(os, 'fsync', fsync)
    train(tmp_path / 'counted' / 'run')
    assert learnt(tmp_path / 'counted' / 'run') == undisturbed
    writes = written
    assert writes > 15
    every = range(1, writes + 1)
    for write in every if nightly else random.Random(SEED).sample(every, 6):
        run = tmp_path / str(write) / 'run'
        written, full_from = 0, write
        with pytest.raises(OSError, match='No space left on device') as caught:
            train(run)
        assert str(run) in str(caught.value)
        assert not list(run.rglob('*.part'))
        full_from = math.inf
        train(run)
        # A checkpoint more may be there, when it was full as an older one was to go.
        left = learnt(run)
        assert {name: left[name] for name in undisturbed} == undisturbed, f'{write} of {writes}'


def test_a_clock_that_is_set_back_changes_nothing(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, undisturbed: dict[str, Any]) -> None:
    jumps, real = random.Random(SEED), time.time
    monkeypatch.setattr(time, 'time', lambda: real() + jumps.uniform(-86_400.0, 86_400.0))
    statuses = train(tmp_path / 'run')
    assert learnt(tmp_path / 'run') == undisturbed
    assert all(0.0 <= status.elapsed < 60.0 for status in statuses)
    assert all(not status.remaining < 0.0 for status in statuses)
    for line in RunFolder(tmp_path / 'run', resume=True).lines():
        assert 0.0 <= line['seconds'] < 60.0
        assert line['steps_per_second'] is None or line['steps_per_second'] > 0


def test_folders_named_after_the_time_are_never_taken_twice(tmp_path: Path) -> None:
    wanted = tmp_path / 'runs' / 'rocket-20261121-120000'

    def ask(_: int) -> str:
        return subprocess.run(
            [sys.executable, '-m', 'ppo_agent_node.runs.new_paths', wanted], capture_output=True,
            text=True, timeout=20, check=True).stdout.strip()

    with ThreadPoolExecutor(8) as pool:
        given = sorted(pool.map(ask, range(8)))
    assert len(set(given)) == 8
    assert given[0] == str(wanted)
    assert all(Path(name).is_dir() for name in given)
    name = tmp_path / f'report-{datetime(2026, 1, 1):%Y}'
    assert [new_folder(name).name for _ in range(3)] == [
        'report-2026', 'report-2026-2', 'report-2026-3']
