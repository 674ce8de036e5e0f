# SPDX-License-Identifier: Apache-2.0
"""A participant that forges all messages of agent and simulator, and sends them first.

It only needs to be in the same domain: it subscribes to the topics of both and publishes messages
in their names. Run as a program, it is a node whose parameter `kinds` lists the kinds of messages
to forge, separated by commas.
"""
from __future__ import annotations

from typing import Any

import numpy as np

KINDS = ('reward', 'observation', 'episodes', 'action', 'flood', 'world', 'state', 'training',
         'services')
_WORLD_PERIOD = 10
"""steps between two forged messages on `world`"""
_FIRST_SESSION = 4711


class Forger:
    """Forges the given kinds of messages with a node."""

    def __init__(self, node: Any, kinds: tuple[str, ...], every: int, num_envs: int = 8) -> None:
        """Create publishers, subscriptions and services.

        :param every: forge at every `every`-th step.
        """
        from rocket_msgs import msg
        from rocket_msgs import srv

        from rocket_sim_node.wire.dds import qos
        from rocket_sim_node.wire.messages.cdr import Codec

        self._kinds, self._every, self._rows = kinds, every, num_envs
        self._agent, self._world = 0, None
        self.session, self.sent = 0, dict.fromkeys(KINDS, 0)
        self._none = np.zeros(0)
        topics = {'reward': msg.Reward, 'observation': msg.Observation,
                  'episodes': msg.Episodes, 'action': msg.Action}
        self._codecs = {name: Codec(kind) for name, kind in topics.items()}
        topics |= {'world': msg.World, 'state': msg.RocketState, 'training': msg.TrainingStatus}
        wanted = {'action' if kind == 'flood' else kind for kind in kinds}
        self.publishers = {
            name: node.create_publisher(
                kind, name, qos.WORLD if name == 'world' else qos.STREAM)
            for name, kind in topics.items() if name in wanted}
        self._types = topics
        best = qos.read_stream('never')
        node.create_subscription(msg.Observation, 'observation', self._on_observation, best)
        node.create_subscription(msg.Action, 'action', self._on_action, best)
        node.create_subscription(msg.World, 'world', self._on_world, qos.WORLD)
        if 'services' in kinds:
            for name in ('Reset', 'Restore', 'Snapshot'):
                node.create_service(
                    getattr(srv, name), f'simulator/{name.lower()}', self._serve)

    def _on_world(self, message: Any) -> None:
        if message.session >= 2 * _FIRST_SESSION:
            self._world = message

    def _on_action(self, message: Any) -> None:
        self._agent = message.agent

    def _serve(self, request: Any, response: Any) -> Any:
        """Answer as the simulator would, with an invented state."""
        self.sent['services'] += 1
        response.code = response.OK
        if hasattr(response, 'state'):
            response.state = bytes(1000)
        else:
            response.session = self.session
            response.observation = [0.5] * (15 * self._rows)
        return response

    def _on_observation(self, message: Any) -> None:
        """Forge the next action before the agent sends it, and the answer to that action."""
        if not len(message.data) or message.data[0] == 0.5:
            return  # it was forged by this node
        session, step, rows = message.session, message.step, self._rows
        self.session = session
        if step % self._every:
            return
        nones = np.zeros(rows)
        self._say('reward', (session, step + 1), (
            np.full(rows, 100.0), nones, nones, self._none, self._none))
        self._say('observation', (session, step + 1), (np.full(len(message.data), 0.5),))
        self._say('episodes', (session, step + 1), [nones] * 13)
        if self._agent:
            actions = (np.ones(3 * rows), self._none)
            self._say('action', (session, step, self._agent), actions)
            for ahead in range(8):
                self._say('action', (session, step + ahead, self._agent), actions, 'flood')
        for name in ('state', 'training'):
            if name in self._kinds:
                self.publishers[name].publish(self._types[name]())
                self.sent[name] += 1
        if 'world' in self._kinds and self._world is not None and step % _WORLD_PERIOD == 0:
            self._world.session, self._world.step = _FIRST_SESSION + self.sent['world'], 0
            self.publishers['world'].publish(self._world)
            self.sent['world'] += 1

    def _say(self, topic: str, numbers: Any, arrays: Any, kind: str = '') -> None:
        if (kind or topic) in self._kinds:
            self.publishers[topic].publish(self._codecs[topic].encode(numbers, arrays))
            self.sent[kind or topic] += 1


def forge(node: Any, executor: Any) -> None:
    """Run the node."""
    from rclpy.parameter import Parameter

    from rocket_sim_node.wire.node import stopping
    every = node.get_parameter_or('every', Parameter('every', value=1)).value
    forger = Forger(node, tuple(node.get_parameter('kinds').value.split(',')), every)
    node.get_logger().info('forging')
    while not stopping.requested():
        executor.spin_once(timeout_sec=0.1)
    node.get_logger().info(f'forged {forger.sent}')


if __name__ == '__main__':
    import sys

    from rocket_sim_node.wire.node.running import run
    sys.exit(run('forger', forge))
