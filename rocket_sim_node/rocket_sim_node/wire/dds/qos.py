# SPDX-License-Identifier: Apache-2.0
"""Quality of service of each stream."""
from __future__ import annotations

from rclpy.qos import DurabilityPolicy
from rclpy.qos import HistoryPolicy
from rclpy.qos import QoSProfile
from rclpy.qos import ReliabilityPolicy

from rocket_sim_node.wire.dds.transport import beyond_machine
from rocket_sim_node.wire.dds.transport import receive_buffer
from rocket_sim_node.wire.dds.transport import set_up_by_user


def _reliable(depth: int, durability: DurabilityPolicy) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, durability=durability,
        reliability=ReliabilityPolicy.RELIABLE)


WORLD = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""Description of a simulator: late joiners receive the last one."""

READ_WORLD = _reliable(16, DurabilityPolicy.TRANSIENT_LOCAL)
"""The same for its readers: others may publish there, too, and must not displace it."""

_SENDERS = 8
"""Messages that a receive buffer is expected to hold at once. A participant has one socket for all
its simulators, which may answer at the same time."""

STREAM = _reliable(4, DurabilityPolicy.VOLATILE)
"""Action, observation, reward: stale data is rejected by session and step, not by depth."""

ACKNOWLEDGE = ('auto', 'always', 'never')
"""When readers of a stream acknowledge messages, so that DDS repeats lost ones."""


def _is_large(size: int) -> bool:
    buffer = receive_buffer() if size else None
    return buffer is not None and size > buffer / _SENDERS


def read_stream(acknowledge: str, size: int = 0) -> QoSProfile:
    """Return the QoS for reading a stream; writers support both modes.

    Within one machine, messages are lost only when a socket is full, and the agent re-sends in
    that case; acknowledgements cost time and wake threads. `auto` therefore acknowledges only when
    peers on other machines may be discovered (by range, by name, or by a user's own
    configuration), or when a message is larger than the share of the receive buffer that is left
    to each of several simulators.

    :param size: of a message, bytes; 0: small.
    """
    if acknowledge == 'always' or (acknowledge == 'auto' and (
            beyond_machine() or set_up_by_user() or _is_large(size))):
        return STREAM
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=STREAM.depth, durability=STREAM.durability,
        reliability=ReliabilityPolicy.BEST_EFFORT)

REQUESTS = _reliable(16, DurabilityPolicy.VOLATILE)
"""For the events by which a service learns which client is calling it."""

EVENTS = _reliable(100, DurabilityPolicy.VOLATILE)
"""Episodes, state, training status: for observers."""

VIEWS = _reliable(100, DurabilityPolicy.VOLATILE)
"""Standard messages for viewers, `/tf` among them: the profile of tf2's broadcasters. A message of
`state` brings up to 50 steps at once."""

LATCHED = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""For messages that change rarely: late joiners receive the last one."""

CLOCK = _reliable(1, DurabilityPolicy.VOLATILE)
"""`/clock`: only the newest time counts."""
