# SPDX-License-Identifier: Apache-2.0
"""Node `expert_pilot`: the scripted pilot of the world, on the same topics as the agent."""
from __future__ import annotations

from ppo_agent_node.nodes.piloting import run_pilot
from ppo_agent_node.pilots.scripted import scripted_pilot
from rocket_sim_node.wire.node.running import leave


def main() -> None:
    """Run the node."""
    leave(run_pilot('expert_pilot', lambda spec, seed: scripted_pilot(spec)))


if __name__ == '__main__':
    main()
