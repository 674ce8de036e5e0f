# SPDX-License-Identifier: Apache-2.0
"""Node `ppo_agent`: trains a policy in a simulator, or flies a trained one."""
from __future__ import annotations

from rocket_sim_node.wire.node.running import Body
from rocket_sim_node.wire.node.running import Errors
from rocket_sim_node.wire.node.running import leave
from rocket_sim_node.wire.node.running import run_late


def _load() -> tuple[Body, Errors]:
    from ppo_agent_node.nodes.agent.modes import act
    from ppo_agent_node.nodes.flights.connection import EXPECTED_ERRORS
    return act, EXPECTED_ERRORS


def main() -> None:
    """Run the node."""
    leave(run_late('ppo_agent', _load, expected=(ValueError, OSError)))


if __name__ == '__main__':
    main()
