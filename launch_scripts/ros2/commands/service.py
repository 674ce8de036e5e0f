# SPDX-License-Identifier: Apache-2.0
"""Services: their names, and calls."""
from __future__ import annotations

import argparse
import os

import rclpy

from ros2 import graph
from ros2 import messages
from ros2.errors import CommandError
from ros2.verb import Verb


def names(args: argparse.Namespace) -> None:
    """Print one service a line."""
    with graph.direct_node() as node:
        graph.look_around(node)
        for name, _ in sorted(node.get_service_names_and_types()):
            if not graph.is_hidden(name):
                print(name)


def call(args: argparse.Namespace) -> None:
    """Call it once and print request and response."""
    # Else a value of another type is an abort of the process.
    os.environ.setdefault('ROS_PYTHON_CHECK_FIELDS', '1')
    kind = graph.load_type(args.service_type, 'srv')
    if not hasattr(kind, 'Request'):
        raise CommandError('The passed type is not a service')
    request = kind.Request()
    messages.fill_from_yaml(request, args.values, 'Failed to populate field')
    with graph.direct_node() as node:
        client = node.create_client(kind, args.service_name)
        if not client.service_is_ready():
            print('waiting for service to become available...', flush=True)
            client.wait_for_service()
        print(f'requester: making request: {request!r}\n', flush=True)
        future = client.call_async(request)
        rclpy.spin_until_future_complete(node, future)
        print(f'response:\n{future.result()!r}\n')


VERBS = {
    'list': Verb('Output a list of available services', names),
    'call': Verb('Call a service', call, {
        'service_name': {
            'help': "Name of the ROS service to call to (e.g. '/add_two_ints')"},
        'service_type': {'help': "Type of the ROS service (e.g. 'std_srvs/srv/Empty')"},
        'values': {
            'nargs': '?', 'default': '{}',
            'help': "Values to fill the service request with in YAML format "
                    "(e.g. '{a: 1, b: 2}'), otherwise the service request will be published "
                    'with default values'}}),
}
