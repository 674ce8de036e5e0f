# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node: their names and values, and new values."""
from __future__ import annotations

import argparse
import sys
from typing import Any

import rclpy
from rcl_interfaces.msg import Parameter
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters
from rcl_interfaces.srv import ListParameters
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import get_parameter_value
from rclpy.parameter import parameter_value_to_python

from ros2 import graph
from ros2.errors import CommandError
from ros2.verb import Verb

_SECONDS = 5.0
_LABELS = {
    ParameterType.PARAMETER_BOOL: 'Boolean value is:',
    ParameterType.PARAMETER_INTEGER: 'Integer value is:',
    ParameterType.PARAMETER_DOUBLE: 'Double value is:',
    ParameterType.PARAMETER_STRING: 'String value is:',
    ParameterType.PARAMETER_BYTE_ARRAY: 'Byte values are:',
    ParameterType.PARAMETER_BOOL_ARRAY: 'Boolean values are:',
    ParameterType.PARAMETER_INTEGER_ARRAY: 'Integer values are:',
    ParameterType.PARAMETER_DOUBLE_ARRAY: 'Double values are:',
    ParameterType.PARAMETER_STRING_ARRAY: 'String values are:',
}


def _wait_for_node(node: Node, name: str) -> str:
    """Return the full name of a node, once it is there.

    :raises CommandError: when it does not appear in time.
    """
    full = graph.absolute(name)
    if not graph.wait_for(node, lambda: full in graph.node_names(node)):
        raise CommandError('Node not found')
    return full


def _call(node: Node, kind: Any, service: str, request: Any) -> Any:
    """Return the response of a parameter service.

    :raises CommandError: when there is none in time.
    """
    client = node.create_client(kind, service)
    try:
        if client.wait_for_service(_SECONDS):
            future = client.call_async(request)
            rclpy.spin_until_future_complete(node, future, timeout_sec=_SECONDS)
            if future.done():
                return future.result()
    finally:
        node.destroy_client(client)
    raise CommandError(f"Wait for service timed out waiting for '{service}'")


def names(args: argparse.Namespace) -> None:
    """Print one parameter a line."""
    with graph.direct_node() as node:
        if args.node_name:
            nodes = [_wait_for_node(node, args.node_name)]
        else:
            graph.look_around(node)
            nodes = sorted(set(graph.node_names(node)))
        for name in nodes:
            response = _call(
                node, ListParameters, f'{name}/list_parameters', ListParameters.Request())
            if not args.node_name and response.result.names:
                print(f'{name}:')
            for parameter in sorted(response.result.names):
                print(f'  {parameter}')


def get(args: argparse.Namespace) -> None:
    """Print the value."""
    with graph.direct_node() as node:
        name = _wait_for_node(node, args.node_name)
        request = GetParameters.Request(names=[args.parameter_name])
        response = _call(node, GetParameters, f'{name}/get_parameters', request)
        if not response.values:
            raise CommandError('Parameter not set')
        value = response.values[0]
        if value.type == ParameterType.PARAMETER_NOT_SET:
            print('Parameter not set.')
            return
        plain = parameter_value_to_python(value)
        plain = list(plain) if hasattr(plain, 'tolist') else plain
        print(f'{_LABELS[value.type]} {plain}')


def set_value(args: argparse.Namespace) -> int:
    """Set it and say whether the node took it."""
    with graph.direct_node() as node:
        name = _wait_for_node(node, args.node_name)
        parameter = Parameter(name=args.parameter_name, value=get_parameter_value(args.value))
        response = _call(
            node, SetParameters, f'{name}/set_parameters',
            SetParameters.Request(parameters=[parameter]))
        result, = response.results
        reason = f': {result.reason}' if result.reason else ''
        if result.successful:
            print(f'Set parameter successful{reason}')
            return 0
        print(f'Setting parameter failed{reason}', file=sys.stderr)
    return 1


_NODE = {'node_name': {'help': 'Name of the ROS node'}}
_PARAMETER = {**_NODE, 'parameter_name': {'help': 'Name of the parameter'}}
VERBS = {
    'list': Verb('Output a list of available parameters', names, {
        'node_name': {'nargs': '?', 'help': 'Name of the ROS node'}}),
    'get': Verb('Get parameter', get, {**_PARAMETER}),
    'set': Verb('Set parameter', set_value, {
        **_PARAMETER, 'value': {'help': 'Value of the parameter'}}),
}
