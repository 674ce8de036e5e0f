# SPDX-License-Identifier: Apache-2.0
"""Quality of service of the wire, by stream."""
from __future__ import annotations

from rclpy.qos import DurabilityPolicy
from rclpy.qos import HistoryPolicy
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy


def _reliable(depth: int, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, durability=durability,
        reliability=ReliabilityPolicy.RELIABLE)


WORLD = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""The description of a simulator: late joiners get the last one."""

STREAM = _reliable(4, DurabilityPolicy.VOLATILE)
"""Action, observation, reward: stale data is refused by session and step, not by depth."""

EVENTS = _reliable(100, DurabilityPolicy.VOLATILE)
"""Episodes, state, training status: for those who watch."""
