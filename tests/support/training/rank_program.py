# SPDX-License-Identifier: Apache-2.0
"""Small training runs of several ranks: starts the ranks, and is their program."""
from __future__ import annotations

import errno
import multiprocessing
import os
import socket
import tempfile
import time
from pathlib import Path
from typing import Any

from ppo_agent_node.config.training_config import make_config
from ppo_agent_node.distributed.rendezvous import joined
from ppo_agent_node.distributed.run_folder import open_folder
from ppo_agent_node.training.trainer import Trainer
from rocket_sim_node import worlds
from rocket_sim_node.telemetry.training_status import Status
from rocket_sim_node.worlds.jobs import SerialFleet

PATIENCE = 100.0
WORLD: dict[str, Any] = {'level': 7, 'spawn_height': 30.0, 'time_limit': 6.0}


def free_port() -> int:
    """Return a free TCP port of the loopback interface."""
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        port: int = probe.getsockname()[1]
        return port


def variables(rank: int, count: int, port: int, host: str = '127.0.0.1') -> dict[str, str]:
    """Return the environment variables with which a rank finds the others."""
    return {'RANK': str(rank), 'WORLD_SIZE': str(count), 'MASTER_ADDR': host,
            'MASTER_PORT': str(port)}


def train(
    path: Path, count: int, values: dict[str, Any], on_rank: dict[int, dict] | None = None,
    awaited: int | None = None, **given: Any,
) -> list[str]:
    """Train with several ranks, each a process; return the output of each.

    :param on_rank: arguments of `main` that differ on a rank, by rank.
    :param awaited: number of ranks, from rank 0, that end by themselves; by default all.
    :param given: arguments of `main`.
    """
    # Forked from a process that has imported PyTorch, a rank starts in a tenth of the time.
    context = multiprocessing.get_context('forkserver')
    context.set_forkserver_preload([__name__])
    port = free_port()
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        outputs = [Path(folder, str(rank)) for rank in range(count)]
        processes = [
            context.Process(target=_run_rank, args=(
                outputs[rank],
                {**variables(rank, count, port), 'TMPDIR': str(path.parent)},
                {'path': path, 'values': values, **given, **(on_rank or {}).get(rank, {})}))
            for rank in range(count)]
        for process in processes:
            process.start()
        try:
            for process in processes[:awaited]:
                process.join(PATIENCE)
                assert process.exitcode is not None, 'a rank still runs'
        finally:
            for process in processes:
                process.kill()
                process.join()
        return [output.read_text() for output in outputs[:awaited]]


def _run_rank(output: Path, environment: dict[str, str], arguments: dict[str, Any]) -> None:
    """Run `main` in a process of its own, with its output in a file."""
    with output.open('wb') as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    os.environ.update(environment)
    main(**arguments)


def main(
    path: Path, values: dict[str, Any], resume: bool = False, low: dict[str, Any] = WORLD,
    stop_at: int = 0, die_at: int = 0, sleep_at: int = 0, full_at: int = 0,
) -> None:
    """Train; stop, be killed, sleep or find the disk full when an iteration is reported."""
    reached = [0]

    def report(status: Status) -> None:
        reached[0] = status.iteration if status.stage == 'finetune' else 0
        if die_at and reached[0] >= die_at:
            os.kill(os.getpid(), 9)
        if sleep_at and reached[0] >= sleep_at:
            time.sleep(PATIENCE)
        if full_at and reached[0] >= full_at:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), 'train.jsonl')

    world = worlds.make('rocket', num_envs=8, **low)
    with (
        joined(say=lambda text: print(text, flush=True)) as ranks,
        open_folder(path, resume, ranks) as folder,
    ):
        result = Trainer(
            SerialFleet(world), make_config(values), folder, report,
            stop_requested=lambda: bool(stop_at) and reached[0] >= stop_at, ranks=ranks).run()
        print('finished' if result.finished else 'stopped', flush=True)
