# SPDX-License-Identifier: Apache-2.0
"""Counters of refusals and faults, logged with throttling and published on `/diagnostics`."""
from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from rclpy.node import Node

from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.node.steady_clock import STEADY
from rocket_sim_node.wire.node.steady_clock import create_timer

PERIOD = 1.0
"""Seconds between diagnostics messages."""
_LONGEST = 300
"""Maximum length of a logged refusal, characters; its text may come from any sender."""


def shortened(text: str) -> str:
    """Return a text cut to the maximum length."""
    if len(text) <= _LONGEST:
        return text
    return f'{text[:_LONGEST]} ... ({len(text)} characters)'


class DiagnosticsPublisher:
    """Counts refusals and other events of a node, and reports them once a second.

    The level is ERROR while an alarm is active, WARN after a refusal or warning within the last
    second, and OK otherwise.
    """

    def __init__(
        self, node: Node, events: tuple[str, ...] = (),
        present: Callable[[], Mapping[str, object]] = dict,
    ) -> None:
        """Create the publisher of `/diagnostics`, which ROS expects by its absolute name.

        :param events: counters that are reported from the start, as 0.
        :param present: returns further current values to report, by name.
        """
        self._node, self._present = node, present
        self._counts: Counter[str] = Counter(dict.fromkeys(events, 0))
        self._last = self._refused = self._alarm = ''
        self._fresh = False
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', qos.EVENTS)
        create_timer(node, PERIOD, self._report)

    def count(self, name: str) -> None:
        """Count an event that is not a fault."""
        self._counts[name] += 1

    def refuse(self, where: str, why: str) -> None:
        """Count and log invalid input.

        The first refusal, and the first after a second without any, are reported at once.

        :param where: topic or service.
        :param why: names field and value.
        """
        self._counts[f'refused on {where}'] += 1
        self._refused = shortened(f'{where}: {why}')
        self._node.get_logger().warning(
            f'refused {self._refused}', throttle_duration_sec=PERIOD,
            throttle_time_source_type=STEADY)
        self._tell(self._refused)

    def warn(self, name: str, text: str) -> None:
        """Count, log and report a problem that is not a refusal."""
        self._counts[name] += 1
        self._node.get_logger().warning(
            shortened(text), throttle_duration_sec=PERIOD, throttle_time_source_type=STEADY)
        self._tell(shortened(text))

    def alarm(self, name: str, text: str) -> None:
        """Count and log a fault, and report an error until `clear`."""
        self._counts[name] += 1
        self._alarm = text
        self._node.get_logger().warning(text)
        self._publish()

    def clear(self, text: str = '') -> None:
        """End an active alarm and log the reason."""
        if not self._alarm:
            return
        self._alarm = ''
        if text:
            self._node.get_logger().info(text)
        self._publish()

    def _tell(self, text: str) -> None:
        self._last = text
        if not self._fresh:
            self._fresh = True
            self._publish()

    def _report(self) -> None:
        self._publish()
        self._fresh = False

    def _publish(self) -> None:
        name = self._node.get_fully_qualified_name().strip('/')
        level, text = DiagnosticStatus.OK, 'ok'
        if self._alarm:
            level, text = DiagnosticStatus.ERROR, self._alarm
        elif self._fresh:
            level, text = DiagnosticStatus.WARN, self._last
        values = {
            **self._present(), **dict(sorted(self._counts.items())),
            'last refusal': self._refused}
        status = DiagnosticStatus(
            level=level, name=f'{name}: wire', message=text, hardware_id=name,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
