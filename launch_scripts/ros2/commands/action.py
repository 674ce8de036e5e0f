# SPDX-License-Identifier: Apache-2.0
"""Actions: their names, and goals."""
from __future__ import annotations

import argparse
import os
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ros2 import graph
from ros2 import messages
from ros2.errors import CommandError
from ros2.verb import Verb

_SPIN_SECONDS = 0.1
"""Longest wait for DDS, during which Python cannot handle Ctrl-C."""
_STATUS = {4: 'SUCCEEDED', 5: 'CANCELED', 6: 'ABORTED'}
"""Names of the final states in action_msgs/msg/GoalStatus."""


def names(args: argparse.Namespace) -> None:
    """Print one action a line."""
    from rclpy.action import get_action_names_and_types
    with graph.direct_node() as node:
        graph.look_around(node)
        for name, types in sorted(get_action_names_and_types(node)):
            if not graph.is_hidden(name):
                print(f'{name} [{", ".join(types)}]' if args.show_types else name)


def send_goal(args: argparse.Namespace) -> None:
    """Send it and print its result; Ctrl-C cancels it."""
    from rclpy.action import ActionClient

    # Otherwise a value of the wrong type aborts the process.
    os.environ.setdefault('ROS_PYTHON_CHECK_FIELDS', '1')
    kind = graph.load_type(args.action_type, 'action')
    goal = kind.Goal()
    messages.fill_from_yaml(goal, args.goal, 'Failed to populate message fields')

    # rclpy's own handler would shut the context down, and nothing could be cancelled any more.
    with graph.direct_node(SignalHandlerOptions.NO) as node:
        client = ActionClient(node, kind, args.action_name)
        print('Waiting for an action server to become available...', flush=True)
        while not client.server_is_ready():
            rclpy.spin_once(node, timeout_sec=_SPIN_SECONDS)
        print(f'Sending goal:\n{_indented(goal)}', flush=True)
        handle = _wait(node, client.send_goal_async(
            goal, _print_feedback if args.feedback else None))
        if not handle.accepted:
            print('Goal was rejected.')
            return
        print(f'Goal accepted with ID: {bytes(handle.goal_id.uuid).hex()}\n', flush=True)
        result = handle.get_result_async()
        try:
            answer = _wait(node, result)
        except (KeyboardInterrupt, BrokenPipeError):
            # Sent before anything is printed, which fails where the pipe is closed.
            cancelled = handle.cancel_goal_async()
            print('Canceling goal...', flush=True)
            if not _wait(node, cancelled).goals_canceling:
                raise CommandError('Failed to cancel goal') from None
            print('Goal canceled.', flush=True)
            answer = _wait(node, result)
        print(f'Result:\n{_indented(answer.result)}')
        print(f'Goal finished with status: {_STATUS.get(answer.status, "UNKNOWN")}')


def _wait(node: Node, future: Any) -> Any:
    """Return the result of a future."""
    while not future.done():
        rclpy.spin_until_future_complete(node, future, timeout_sec=_SPIN_SECONDS)
    return future.result()


def _print_feedback(message: Any) -> None:
    print(f'Feedback:\n{_indented(message.feedback)}', flush=True)


def _indented(message: Any) -> str:
    """Return a message as YAML, as the real command prints it."""
    return ''.join(f'    {line}\n' for line in messages.to_yaml(message).splitlines())


VERBS = {
    'list': Verb('Output a list of action names', names, {
        '-t --show-types': {
            'action': 'store_true', 'help': 'Additionally show the action type'}}),
    'send_goal': Verb('Send an action goal', send_goal, {
        'action_name': {'help': "Name of the ROS action (e.g. '/fibonacci')"},
        'action_type': {
            'help': "Type of the ROS action (e.g. 'example_interfaces/action/Fibonacci')"},
        'goal': {'help': "Goal request values in YAML format (e.g. '{order: 10}')"},
        '-f --feedback': {
            'action': 'store_true', 'help': 'Echo feedback messages for the goal'}}),
}
