# SPDX-License-Identifier: Apache-2.0
"""Publisher of a training's status, on the terminal and on topic `training`."""
from __future__ import annotations

import os
import time
from dataclasses import asdict
from dataclasses import replace

from rclpy.node import Node
from rocket_msgs.msg import TrainingStatus
from std_msgs.msg import Header

from ppo_agent_node.distributed.rendezvous import assignments
from ppo_agent_node.nodes.agent.rosout import show_warnings
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.terminal import Terminal
from rocket_sim_node.printable import shell_command
from rocket_sim_node.telemetry.training_status import Status
from rocket_sim_node.wire.dds import qos

STARTED_BY_TRAIN = 'HOVERSLAM_TRAIN'
"""Set if launch_scripts/train itself prints how to resume."""


class StatusPublisher:
    """Reports the status of a run."""

    def __init__(
        self, node: Node, terminal: Terminal, folder: RunFolder, second: str = '',
    ) -> None:
        """Report where the run is.

        :param second: namespace, below the node's own, of a second simulator.
        """
        self._terminal, self._folder = terminal, folder
        self._namespace, self._clock = node.get_namespace(), node.get_clock()
        self._publisher = node.create_publisher(TrainingStatus, 'training', qos.EVENTS)
        self._began = time.monotonic()
        self._last = Status(run=folder.name, folder=str(folder.path))
        terminal.say(f'run {folder.path}')
        terminal.wait_for('the simulator', self._last)
        show_warnings(node, terminal, second)

    def report(self, status: Status) -> None:
        """Report an iteration of learning, or an event."""
        status = replace(status, stages=(*status.stages, 'evaluate'))
        self._last = status
        self._tell(status)

    def report_evaluation(self, status: Status) -> None:
        """Report evaluation flights, with the known status of the run."""
        self._tell(replace(
            status, **self._last.of_run(), elapsed=time.monotonic() - self._began,
            progress=status.iteration, goal=status.iterations, unit='episodes',
            saved=status.saved or self._last.saved))

    def advise(self, simulators: str, loggers: str = '') -> None:
        """Print how to resume, unless the parent process does; remove a run that never began.

        :param simulators: namespaces of the simulators, as given to the agent.
        :param loggers: of this start, as given to the agent.
        """
        if STARTED_BY_TRAIN in os.environ:
            return
        if not self._folder.config.exists():
            self._folder.withdraw()
            self._terminal.say('stopped before the run began; start it again the same way')
            return
        rank = assignments()
        words = ['env', *rank] if rank else []
        words += ['ros2', 'run', 'ppo_agent_node', 'ppo_agent', '--ros-args']
        if self._namespace != '/':
            words += ['-r', f'__ns:={self._namespace}']
        if simulators:
            words += ['-p', f'simulators:={simulators}']
        if loggers:
            words += ['-p', f'loggers:={loggers}']
        words += ['-p', f'run_dir:={self._folder.path.resolve()}', '-p', 'resume:=true']
        others = ', and all other ranks likewise' if rank else ''
        self._terminal.say(
            f'stopped; resume, with the same simulators{others}, by: {shell_command(words)}')

    def _tell(self, status: Status) -> None:
        self._terminal.show(status)
        self._publisher.publish(TrainingStatus(
            header=Header(stamp=self._clock.now().to_msg()), **asdict(status)))
