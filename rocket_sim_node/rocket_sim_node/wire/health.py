# SPDX-License-Identifier: Apache-2.0
"""What went wrong, counted: on the log, throttled, and on `/diagnostics`."""
from __future__ import annotations

from collections import Counter

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from rclpy.node import Node

from rocket_sim_node.wire import qos
from rocket_sim_node.wire.steady import create_timer

PERIOD = 1.0
"""s between diagnostics"""


class Health:
    """Counts refusals and other events of a node and reports them once a second."""

    def __init__(self, node: Node) -> None:
        """Advertise `/diagnostics`, the one topic that ROS expects by its absolute name."""
        self._node = node
        self._counts: Counter[str] = Counter()
        self._last = ''
        self._fresh = False
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', qos.EVENTS)
        create_timer(node, PERIOD, self._report)

    def count(self, name: str) -> None:
        """Count something that is no fault."""
        self._counts[name] += 1

    def refuse(self, where: str, why: str) -> None:
        """Count and log bad input; `where` is the topic or service, `why` names field and value.

        The first refusal, and the first after a quiet second, are reported at once.
        """
        self._counts[f'refused on {where}'] += 1
        self._last = f'{where}: {why}'
        self._node.get_logger().warning(
            f'refused {self._last}', throttle_duration_sec=PERIOD)
        if not self._fresh:
            self._fresh = True
            self._publish()

    def _report(self) -> None:
        self._publish()
        self._fresh = False

    def _publish(self) -> None:
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if self._fresh else DiagnosticStatus.OK,
            name=f'{self._node.get_fully_qualified_name()}: wire',
            message=self._last if self._fresh else 'ok',
            hardware_id=self._node.get_fully_qualified_name(),
            values=[KeyValue(key=k, value=str(v)) for k, v in sorted(self._counts.items())],
        )
        status.values.append(KeyValue(key='last refusal', value=self._last))
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
