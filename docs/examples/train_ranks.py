# SPDX-License-Identifier: Apache-2.0
"""Several processes train one policy without ROS: torchrun starts a rank for each.

torchrun --nproc-per-node 2 docs/examples/train_ranks.py runs/ranks preset=quick num_groups=2
"""
from __future__ import annotations

import signal
import sys
import threading
from pathlib import Path

from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.distributed.errors import RankLost
from ppo_agent_node.distributed.rendezvous import joined
from ppo_agent_node.distributed.run_folder import open_folder
from ppo_agent_node.training.trainer import Trainer
from rocket_sim_node import worlds
from rocket_sim_node.command_line import read_value
from rocket_sim_node.telemetry.training_status import Status
from rocket_sim_node.worlds import EnvironmentClosed
from rocket_sim_node.worlds.jobs import SerialFleet


def main(run: str, *settings: str) -> None:
    """Train in folder `run`; settings are written as name=value."""
    stop = threading.Event()  # torchrun ends the other ranks by SIGTERM when one fails
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())

    def poll() -> None:
        if stop.is_set():
            raise EnvironmentClosed('asked to stop')

    for setting in settings:
        if '=' not in setting:
            raise ValueError(f'got {setting!r}, expected NAME=VALUE')
    given = dict(setting.split('=', 1) for setting in settings)
    preset, world = given.pop('preset', 'default'), given.pop('world', 'rocket')
    defaults = load_preset(preset, world).flat()
    values = {name: read_value(text, defaults.get(name)) for name, text in given.items()}
    config = load_preset(preset, world, **{'threads': 1, **values})
    fleet = SerialFleet(worlds.make(world, num_envs=256))
    with (
        joined(poll=poll, say=print) as ranks,
        open_folder(Path(run), True, ranks, poll) as folder,
    ):
        def report(status: Status) -> None:
            if ranks.first and status.message:
                print(status.message)

        result = Trainer(
            fleet, config, folder, report, stop_requested=stop.is_set, ranks=ranks).run()
    if ranks.first:
        print(f'policy: {result.policy}' if result.finished else 'stopped; start again to resume')


if __name__ == '__main__':
    try:
        main(*sys.argv[1:])
    except EnvironmentClosed:  # while waiting for the other ranks
        print('stopped before the training began')
    except (OSError, RankLost, TypeError, ValueError) as error:
        sys.exit(f'{sys.argv[0]}: {error}')
