# SPDX-License-Identifier: Apache-2.0
"""Node `watch`: shows the progress of a training in this namespace, like its own terminal.

It only listens to `training`; it may start late, stop, and start again. If the training stops
before it is done, it says so and waits, because a run may be resumed.
"""
from __future__ import annotations

import math
import time

from rclpy.executors import Executor
from rclpy.node import Node
from rocket_msgs.msg import TrainingStatus

from ppo_agent_node.config.connection_config import SECOND
from ppo_agent_node.nodes.agent.rosout import show_warnings
from ppo_agent_node.nodes.agent.status_message import status_from_message
from ppo_agent_node.terminal import Terminal
from rocket_sim_node.telemetry.training_status import Status
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.node import stopping
from rocket_sim_node.wire.node.parameters import ParameterError
from rocket_sim_node.wire.node.parameters import Parameters
from rocket_sim_node.wire.node.running import leave
from rocket_sim_node.wire.node.running import run

_SPIN_PERIOD = 0.2
"""Seconds per spin."""
_SILENCE = 1.0
"""Seconds without a report after which to look whether the training is still there: reports may
wait in a queue when this process was stopped."""


def watch(node: Node, executor: Executor) -> None:
    """Show reports until the run is done or this process is asked to stop."""
    Parameters(node).finish()
    done = False
    status, heard = Status(), math.inf  # infinite: nothing to miss
    with Terminal() as terminal:
        def on_status(message: TrainingStatus) -> None:
            nonlocal done, status, heard
            status, heard = status_from_message(message), time.monotonic()
            terminal.show(status)
            done = done or status.stage == 'done'

        node.create_subscription(TrainingStatus, 'training', on_status, qos.EVENTS)
        topic = node.resolve_topic_name('training')
        report = f'a report on {topic}'
        terminal.wait_for(report, status)
        show_warnings(node, terminal, SECOND)
        while not done and not stopping.requested():
            executor.spin_once(timeout_sec=_SPIN_PERIOD)
            terminal.tick()
            if time.monotonic() - heard > _SILENCE and not node.count_publishers(topic):
                heard = math.inf
                terminal.say(f'the training has stopped: nobody reports on {topic}', 'yellow')
                terminal.wait_for(report, status)


def main() -> None:
    """Run the node."""
    leave(run('watch', watch, expected=(ParameterError,)))


if __name__ == '__main__':
    main()
