# SPDX-License-Identifier: Apache-2.0
"""Counters of refusals and faults, logged with throttling and published on `/diagnostics`."""
from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from collections.abc import Hashable
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
_MOST_SOURCES = 100
"""Maximum number of sources of faults that are logged."""


def shortened(text: str) -> str:
    """Return a text cut to the maximum length."""
    if len(text) <= _LONGEST:
        return text
    return f'{text[:_LONGEST]} ... ({len(text)} characters)'


class DiagnosticsPublisher:
    """Counts what a node refused, clipped or warned of, and reports it once a second.

    A first refusal or warning is reported at once. Each report has the counts, the last case, and
    the agent, session and step of the simulator. The level is ERROR while the engine is cut (an
    alarm) and after a fault within the last second, such as a message of another participant, WARN
    after a refusal or warning within the last second, and OK otherwise.
    """

    def __init__(
        self, node: Node, events: tuple[str, ...] = (),
        present: Callable[[], Mapping[str, object]] = dict, quiet: bool = False,
    ) -> None:
        """Create the publisher of `/diagnostics`, which ROS expects by its absolute name.

        :param events: counters that are reported from the start, as 0.
        :param present: returns further current values to report, by name.
        :param quiet: whether to report nothing before the first event.
        """
        self._node, self._present = node, present
        self._counts: Counter[str] = Counter(dict.fromkeys(events, 0))
        self._last = self._refused = self._alarm = self._fault = ''
        self._fresh = self._faulty = False
        self._quiet = quiet
        self._known: set[Hashable] = set()
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

    def fault(self, name: str, source: Hashable, text: Callable[[], str]) -> None:
        """Count a fault that others cause, and report an error; log it once for each source.

        :param source: who caused it.
        :param text: returns the error, or nothing while it is not known in full; not called again
            for this source afterwards, as it may look at the graph.
        """
        self._counts[name] += 1
        first = False
        if (name, source) not in self._known and len(self._known) < _MOST_SOURCES:
            found = text()
            first = bool(found)
            if first:
                self._known.add((name, source))
                self._fault = shortened(found)
                self._node.get_logger().error(self._fault)
        known, self._faulty = self._faulty, True
        if first or not known:
            self._publish()

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
        self._fresh = self._faulty = False

    def _publish(self) -> None:
        if self._quiet and not self._counts:
            return
        name = self._node.get_fully_qualified_name().strip('/')
        level, text = DiagnosticStatus.OK, 'ok'
        if self._alarm:
            level, text = DiagnosticStatus.ERROR, self._alarm
        elif self._faulty and self._fault:
            level, text = DiagnosticStatus.ERROR, self._fault
        elif self._fresh:
            level, text = DiagnosticStatus.WARN, self._last
        values = {
            **self._present(), **dict(sorted(self._counts.items())),
            'last refusal': self._refused, 'last fault': self._fault}
        status = DiagnosticStatus(
            level=level, name=f'{name}: wire', message=text, hardware_id=name,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
