# SPDX-License-Identifier: Apache-2.0
"""Node `simulator`: N rockets of one world, stepped as one batch by the agent's actions."""
from __future__ import annotations

from rocket_sim_node.wire.running import Body
from rocket_sim_node.wire.running import Errors
from rocket_sim_node.wire.running import leave
from rocket_sim_node.wire.running import run_late
from rocket_sim_node.wire.transport import SharedMemory


def _load() -> tuple[Body, Errors]:
    from rocket_sim_node.nodes.serving import simulate
    return simulate, ()


def main() -> None:
    """Run the node."""
    leave(run_late(
        'simulator', _load, expected=(ValueError,), shared_memory=SharedMemory.TO_SEND))


if __name__ == '__main__':
    main()
