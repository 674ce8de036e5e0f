# SPDX-License-Identifier: Apache-2.0
"""Node `watch` beside a training that stops, returns and ends."""
from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rocket_msgs.msg import TrainingStatus
from support.processes import Processes
from support.processes import wait_until

from rocket_sim_node.wire.dds import qos


def test_a_training_that_stops_and_returns(
        processes: Processes, make_node: Callable[..., Any]) -> None:
    watch = processes.run_node('ppo_agent_node', 'watch')
    node, _ = make_node()

    def report(stage: str, message: str) -> Any:
        publisher = node.create_publisher(TrainingStatus, 'training', qos.EVENTS)
        wait_until(lambda: publisher.get_subscription_count() > 0, 30.0)
        publisher.publish(TrainingStatus(stage=stage, message=message))
        watch.wait_for(message, 30.0)
        return publisher

    publisher = report('finetune', 'first report')
    node.destroy_publisher(publisher)
    watch.wait_for('the training has stopped: nobody reports on /training', 30.0)
    report('done', 'last report')
    assert watch.wait(20.0) == 0, watch.output()
    assert watch.output().count('has stopped') == 1
