# SPDX-License-Identifier: Apache-2.0
"""Display of other nodes' warnings on this node's terminal."""
from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial

from rcl_interfaces.msg import Log
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from rclpy.qos import QoSProfile

from ppo_agent_node.terminal import Terminal
from rocket_sim_node.recording.sinks.web_page import INVITATION

_ROSOUT = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def show_warnings(node: Node, terminal: Terminal, second: str = '') -> None:
    """Show warnings of other nodes in this namespace, which a display would otherwise hide.

    The address of a live view is shown too, as users wait for it, and so are this node's own
    warnings if its log goes to a file.

    :param second: namespace below this one whose nodes count as well; empty: none.
    """
    if not terminal.live:
        return
    own = sys.stderr.isatty()
    # A logger has the name of its node, with dots for slashes.
    here = node.get_namespace().strip('/').replace('/', '.')
    prefix = f'{here}.' if here else ''
    skipped = prefix + node.get_name() if own else ''
    node.create_subscription(
        Log, '/rosout', partial(_on_log, terminal.say, prefix, skipped, second), _ROSOUT)


def _on_log(
    say: Callable[[str, str], None], prefix: str, skipped: str, second: str, message: Log,
) -> None:
    name = message.name
    inner = name.removeprefix(prefix)
    node = inner.removeprefix(f'{second}.')
    if not name.startswith(prefix) or name == skipped or '.' in node:
        return
    if message.msg.startswith(INVITATION):
        say(message.msg, '')
    if message.level < Log.WARN:
        return
    grave = message.level >= Log.ERROR
    say(f'{"error" if grave else "warning"}, {inner}: {message.msg}', 'red' if grave else 'yellow')
