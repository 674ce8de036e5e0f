# SPDX-License-Identifier: Apache-2.0
"""Node `random_pilot`: random actions in any world, as a first check of an installation."""
from __future__ import annotations

from ppo_agent_node.nodes.piloting import run_pilot
from ppo_agent_node.pilots.random import RandomPilot
from rocket_sim_node.wire.node.running import leave


def main() -> None:
    """Run the node."""
    leave(run_pilot('random_pilot', RandomPilot))


if __name__ == '__main__':
    main()
