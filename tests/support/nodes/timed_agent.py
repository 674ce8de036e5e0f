# SPDX-License-Identifier: Apache-2.0
"""Node `ppo_agent`, which also prints the times of its exchanges.

It prints the times, in s of the system clock, when it begins to look for its simulator and when
the first step of each flight is answered.
"""
from __future__ import annotations

import time
from typing import Any

import numpy as np

from ppo_agent_node.nodes import ppo_agent
from rocket_sim_node.wire.node.running import Body
from rocket_sim_node.wire.node.running import Errors

load = ppo_agent._load


def load_timed() -> tuple[Body, Errors]:
    """Import the modules of `ppo_agent`, and patch them to print the times."""
    body, errors = load()
    from rocket_sim_node.wire.client.connection import Connection
    from rocket_sim_node.wire.client.fleet import SimulatorFleet
    from rocket_sim_node.worlds.jobs import Act

    begin, take = SimulatorFleet.__init__, Connection.take

    def begin_timed(self: SimulatorFleet, *args: Any, **options: Any) -> None:
        print(f'ready {time.time()}', flush=True)
        begin(self, *args, **options)

    def take_timed(self: Connection) -> Any:
        if isinstance(self._command, Act | np.ndarray) and self.step == 0:
            print(f'exchange {time.time()}', flush=True)
        return take(self)

    SimulatorFleet.__init__, Connection.take = begin_timed, take_timed  # type: ignore[method-assign]
    return body, errors


if __name__ == '__main__':
    ppo_agent._load = load_timed
    ppo_agent.main()
