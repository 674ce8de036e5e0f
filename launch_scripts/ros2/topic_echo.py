# SPDX-License-Identifier: Apache-2.0
"""Output messages from a topic."""
from __future__ import annotations

import argparse
from typing import Any

import rclpy
from rclpy.task import Future

from ros2 import graph
from ros2 import messages
from ros2 import qos
from ros2.errors import CommandError

_TRUNCATE_LENGTH = 128


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    graph.add_arguments(parser)
    qos.add_arguments(parser)
    parser.add_argument(
        'topic_name', help="Name of the ROS topic to listen to (e.g. '/chatter')")
    parser.add_argument(
        'message_type', nargs='?', help="Type of the ROS message (e.g. 'std_msgs/msg/String')")
    parser.add_argument(
        '--csv', action='store_true', help='Output all recursive fields separated by commas')
    parser.add_argument(
        '--field', help="Echo a selected field of a message. Use '.' to select sub-fields.")
    parser.add_argument(
        '--full-length', '-f', action='store_true',
        help="Output all elements for arrays, bytes, and string with a length > "
             "'--truncate-length', by default they are truncated with '...''")
    parser.add_argument(
        '--truncate-length', '-l', type=int, default=_TRUNCATE_LENGTH,
        help=f'The length to truncate arrays, bytes, and string to (default: {_TRUNCATE_LENGTH})')
    parser.add_argument(
        '--no-arr', action='store_true', help="Don't print array fields of messages")
    parser.add_argument(
        '--no-str', action='store_true', help="Don't print string fields of messages")
    parser.add_argument(
        '--flow-style', action='store_true', help='Print collections in the flow style')
    parser.add_argument(
        '--no-lost-messages', action='store_true', help="Don't report when a message is lost")
    parser.add_argument(
        '--once', action='store_true', help='Print the first message received and then exit.')
    parser.add_argument(
        '--timeout', metavar='N', type=float, help='Set a timeout in seconds for waiting')


def select(message: Any, path: str | None) -> Any:
    """Return the field at a dotted path.

    :raises CommandError: when there is none.
    """
    value = message
    for name in filter(None, (path or '').split('.')):
        try:
            value = getattr(value, name)
        except AttributeError as error:
            raise CommandError(f"Invalid field '{path}': {error}") from None
    return value


def show(value: Any, args: argparse.Namespace) -> str:
    """Return the text for a message or a field."""
    options: dict[str, Any] = {
        'truncate': None if args.full_length else args.truncate_length,
        'no_arr': args.no_arr, 'no_str': args.no_str}
    if args.csv:
        return messages.to_csv(value, **options)
    if not hasattr(value, 'get_fields_and_field_types'):
        return f'{value}\n---'
    return messages.to_yaml(value, args.flow_style, **options) + '---'


def main(args: argparse.Namespace) -> None:
    """Print messages until the end."""
    if args.field is not None and not args.field.strip('.'):
        raise CommandError(f"Invalid field value '{args.field}'")
    topic = graph.absolute(args.topic_name)
    with graph.direct_node(args) as node:
        if args.message_type is None:
            kind = graph.topic_type(node, args, topic)
            if kind is None:
                print(f'WARNING: topic [{args.topic_name}] does not appear to be published yet')
                raise CommandError('Could not determine the type for the passed topic')
        else:
            kind = graph.load_type(args.message_type, 'msg')
        graph.wait_for(node, args, lambda: node.count_publishers(topic) > 0)
        done: Future = Future()

        def on_message(message: Any) -> None:
            if done.done():
                return
            try:
                print(show(select(message, args.field), args), flush=True)
            except (CommandError, BrokenPipeError) as error:
                done.set_exception(error)
                return
            if args.once:
                done.set_result(None)

        node.create_subscription(kind, topic, on_message, qos.choose(node, args, topic))
        rclpy.spin_until_future_complete(node, done, timeout_sec=args.timeout)
        if done.done():
            done.result()
