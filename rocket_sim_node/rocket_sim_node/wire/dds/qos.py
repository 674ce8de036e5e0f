# SPDX-License-Identifier: Apache-2.0
"""Quality of service of the wire, by stream."""
from __future__ import annotations

from rclpy.qos import DurabilityPolicy
from rclpy.qos import HistoryPolicy
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy

from rocket_sim_node.wire.dds.transport import beyond_machine
from rocket_sim_node.wire.dds.transport import set_up_by_user


def _reliable(depth: int, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, durability=durability,
        reliability=ReliabilityPolicy.RELIABLE)


WORLD = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""The description of a simulator: late joiners get the last one."""

STREAM = _reliable(4, DurabilityPolicy.VOLATILE)
"""Action, observation, reward: stale data is refused by session and step, not by depth."""

ACKNOWLEDGE = ('auto', 'always', 'never')
"""When those who read a stream acknowledge each message, so that DDS repeats what was lost."""


def read_stream(acknowledge: str) -> QoSProfile:
    """Return how to read a stream; whoever writes one offers both ways.

    Within a machine messages are lost only where a socket is full, and acknowledging them takes
    time and wakes threads; what is lost after all, the agent asks for again. So `auto`
    acknowledges only when peers beyond this machine may be discovered: by range, by name, or by a
    set-up of the user's.
    """
    if acknowledge == 'always' or (
            acknowledge == 'auto' and (beyond_machine() or set_up_by_user())):
        return STREAM
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=STREAM.depth, durability=STREAM.durability,
        reliability=ReliabilityPolicy.BEST_EFFORT)

EVENTS = _reliable(100, DurabilityPolicy.VOLATILE)
"""Episodes, state, training status: for those who watch."""
