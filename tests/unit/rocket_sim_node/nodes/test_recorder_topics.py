# SPDX-License-Identifier: Apache-2.0
"""How the recorder subscribes."""
from __future__ import annotations

from unittest.mock import MagicMock

from rocket_sim_node.nodes.rerun_recorder import RecorderNode
from rocket_sim_node.wire.dds import qos


def test_descriptions_of_other_publishers_do_not_displace_that_of_the_simulator() -> None:
    node = MagicMock()
    RecorderNode(node, MagicMock())
    profiles = {call.args[1]: call.args[3] for call in node.create_subscription.call_args_list}
    assert profiles['world'] == qos.READ_WORLD
