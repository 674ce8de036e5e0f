# SPDX-License-Identifier: Apache-2.0
"""Node `simulator`: N rockets of one world, stepped as one batch by an agent's actions."""
from __future__ import annotations

from rocket_sim_node.wire.node.running import Body
from rocket_sim_node.wire.node.running import Errors
from rocket_sim_node.wire.node.running import leave
from rocket_sim_node.wire.node.running import run_late


def _load() -> tuple[Body, Errors]:
    from rocket_sim_node.nodes.simulation import simulate
    return simulate, ()


def main() -> None:
    """Run the node."""
    leave(run_late('simulator', _load, expected=(ValueError,)))


if __name__ == '__main__':
    main()
