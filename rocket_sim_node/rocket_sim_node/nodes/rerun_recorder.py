# SPDX-License-Identifier: Apache-2.0
"""Node `rerun_recorder`: records the states of a simulator and the training of an agent.

No other node depends on it: it may start late, fall behind, die and be restarted. The launch files
end with it, because it ends by itself only if it cannot record.
"""
from __future__ import annotations

import os
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from rclpy.executors import Executor
from rclpy.node import Node
from rocket_msgs import msg

from rocket_sim_node import free_memory
from rocket_sim_node.nodes.listeners import NICENESS
from rocket_sim_node.nodes.listeners import SPIN_PERIOD
from rocket_sim_node.nodes.listeners import drain
from rocket_sim_node.nodes.listeners import notes_of
from rocket_sim_node.recording.drawing.training_plots import training_of
from rocket_sim_node.recording.recorder import Recorder
from rocket_sim_node.recording.sinks.base import Sink
from rocket_sim_node.recording.sinks.destinations import check_suffix
from rocket_sim_node.recording.sinks.file_sink import FileSink
from rocket_sim_node.recording.sinks.live_sink import LiveSink
from rocket_sim_node.recording.sinks.rerun_program import ViewerError
from rocket_sim_node.recording.sinks.web_page import INVITATION
from rocket_sim_node.recording.sinks.web_page import WebPage
from rocket_sim_node.recording.trajectories import touchdown
from rocket_sim_node.recording.trajectories.filter import RecordingFilter
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.settings import setting
from rocket_sim_node.telemetry.samples import samples_of
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.wire.node import stopping
from rocket_sim_node.wire.node.invalid_input import ignore_invalid_input
from rocket_sim_node.wire.node.parameters import ParameterError
from rocket_sim_node.wire.node.parameters import Parameters
from rocket_sim_node.wire.node.running import USAGE_ERROR
from rocket_sim_node.wire.node.running import leave
from rocket_sim_node.wire.node.running import run
from rocket_sim_node.wire.node.steady_clock import create_timer

_AGENT_GONE = 3.0
"""Seconds without a publisher of training status after which a training counts as over."""


@dataclass(frozen=True)
class Destinations:
    """Destinations of recordings; any number, including none."""

    output: str = setting(
        '', '', 'file to write, .rrd; it appears under its name at the end. An existing file is '
        'never overwritten: the new one is numbered (-2, -3, ...). Empty: none')
    connect: str = setting(
        '', '', 'URL of a running viewer, for example rerun+http://127.0.0.1:9876/proxy; empty: '
        'none')
    serve_web: bool = setting(False, '', 'whether to serve a live web page')
    web_port: int = setting(9090, '', 'port of the web page', 1, 65535)
    web_host: str = setting(
        '127.0.0.1', '', 'address at which the web page is served. The default is this machine '
        'only; with 0.0.0.0 anyone who can reach this machine can see the page')


class RecorderNode:
    """Passes messages to a recorder; `count` is the number received."""

    def __init__(self, node: Node, recorder: Recorder) -> None:
        """Create the subscriptions."""
        self._node = node
        self._recorder = recorder
        self._agent_there = time.monotonic()
        self.count = 0
        for kind, topic, callback, profile in (
            (msg.World, 'world', self._on_world, qos.READ_WORLD),
            (msg.RocketState, 'state', self._on_state, qos.EVENTS),
            (msg.TrainingStatus, 'training', self._on_training, qos.EVENTS),
        ):
            node.create_subscription(kind, topic, callback, profile)
        # `count_publishers` does not apply remapping.
        self._training = node.resolve_topic_name('training')

    def _on_world(self, message: msg.World) -> None:
        self.count += 1
        with ignore_invalid_input(self._node, 'world'):
            self._recorder.world(WorldInfo.of(conversion.world_from_message(message)))

    def _on_state(self, message: msg.RocketState) -> None:
        self.count += 1
        with ignore_invalid_input(self._node, 'state'):
            self._recorder.states(message.session, samples_of(message))

    def _on_training(self, message: msg.TrainingStatus) -> None:
        self.count += 1
        self._agent_there = time.monotonic()
        with ignore_invalid_input(self._node, 'training'):
            self._recorder.training(training_of(message))

    def tick(self) -> None:
        """Log the data that has waited long enough."""
        with ignore_invalid_input(self._node, 'flight'):
            self._recorder.tick()

    def close(self) -> None:
        """Finish everything that can be finished."""
        try:
            with ignore_invalid_input(self._node, 'flight'):
                self._recorder.log_the_rest()
        finally:
            self._recorder.close()

    def look_after_agents(self) -> None:
        """Tell the recorder when the last agent is gone, as the agent may not have reported it."""
        now = time.monotonic()
        if self._node.count_publishers(self._training):
            self._agent_there = now
        elif now - self._agent_there > _AGENT_GONE:
            with ignore_invalid_input(self._node, 'flight'):
                self._recorder.training_is_over()


def record(node: Node, executor: Executor) -> int:
    """Record until asked to stop, or until nothing can be recorded; return the exit status."""
    os.nice(NICENESS)
    parameters = Parameters(node)
    destinations = parameters.declare(Destinations)
    choice = parameters.declare(RecordingFilter)
    parameters.finish()
    if destinations.output:
        check_suffix(destinations.output)

    note = notes_of(node)

    with ExitStack() as stack:
        sinks: list[Sink] = []
        if destinations.connect:
            sinks.append(LiveSink(destinations.connect, note))
        if destinations.serve_web:
            page = WebPage(destinations.web_port, destinations.web_host)
            stack.callback(page.close)
            sinks.append(LiveSink(page.url, note))
            note('INFO', f'{INVITATION}{page.page}')
        file = None
        if destinations.output:
            file = FileSink(Path(destinations.output).absolute(), note)
            sinks.append(file)
        if not sinks:
            note('WARN', 'nothing to do: set output, connect or serve_web')
        recorder = Recorder(choice, sinks, note, settle=touchdown.follow)
        heard = RecorderNode(node, recorder)
        create_timer(node, free_memory.PERIOD, free_memory.give_back)
        if destinations.output:
            note('INFO', f'recording to {destinations.output}')
        try:
            # Viewers come and go; a file ends when its disk is full.
            while not stopping.requested() and (file is None or file.open or len(sinks) > 1):
                executor.spin_once(timeout_sec=SPIN_PERIOD)
                heard.look_after_agents()
                heard.tick()
            drain(executor, lambda: heard.count)
        finally:
            heard.close()
            lost = f'; {recorder.missed} steps were not received' if recorder.missed else ''
            note('INFO', f'{recorder.flights} flights recorded, {recorder.steps} steps{lost}')
    return 0 if file is None or file.complete else USAGE_ERROR


def main() -> None:
    """Run the node."""
    leave(run(
        'rerun_recorder', record, expected=(ParameterError, ValueError, OSError, ViewerError)))


if __name__ == '__main__':
    main()
