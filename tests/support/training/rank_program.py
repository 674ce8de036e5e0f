# SPDX-License-Identifier: Apache-2.0
"""Small training runs of several ranks: starts the ranks, and is their program."""
from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
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
    """Train with several ranks; return the output of each.

    :param on_rank: arguments of `main` that differ on a rank, by rank.
    :param awaited: number of ranks, from rank 0, that end by themselves; by default all.
    :param given: arguments of `main`.
    """
    port = free_port()
    processes = []
    for rank in range(count):
        told = {'path': str(path), 'values': values, **given, **(on_rank or {}).get(rank, {})}
        processes.append(subprocess.Popen(
            [sys.executable, '-m', 'support.training.rank_program', json.dumps(told)],
            env={**os.environ, **variables(rank, count, port), 'OMP_NUM_THREADS': '1',
                 'TMPDIR': str(path.parent), 'PYTHONPATH': os.pathsep.join(sys.path)},
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True))
    try:
        return [process.communicate(timeout=PATIENCE)[0] for process in processes[:awaited]]
    finally:
        for process in processes:
            process.kill()
            process.wait()


def main(
    path: Path, resume: bool, values: dict, low: dict, stop_at: int, die_at: int, sleep_at: int,
) -> None:
    """Train; stop, kill the process or sleep when a given iteration is reported."""
    reached = [0]

    def report(status: Status) -> None:
        reached[0] = status.iteration if status.stage == 'finetune' else 0
        if die_at and reached[0] >= die_at:
            os.kill(os.getpid(), 9)
        if sleep_at and reached[0] >= sleep_at:
            time.sleep(PATIENCE)

    world = worlds.make('rocket', num_envs=8, **low)
    with (
        joined(say=lambda text: print(text, flush=True)) as ranks,
        open_folder(path, resume, ranks) as folder,
    ):
        result = Trainer(
            SerialFleet(world), make_config(values), folder, report,
            stop_requested=lambda: bool(stop_at) and reached[0] >= stop_at, ranks=ranks).run()
        print('finished' if result.finished else 'stopped', flush=True)


if __name__ == '__main__':
    given = json.loads(sys.argv[1])
    main(Path(given['path']), given.get('resume', False), given['values'],
         given.get('low', {'level': 7, 'spawn_height': 30.0, 'time_limit': 6.0}),
         given.get('stop_at', 0), given.get('die_at', 0), given.get('sleep_at', 0))
