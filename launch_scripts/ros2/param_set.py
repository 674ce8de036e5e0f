# SPDX-License-Identifier: Apache-2.0
"""Set parameter."""
from __future__ import annotations

import argparse
import sys

from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import get_parameter_value

from ros2 import graph
from ros2 import parameters


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parameters.add_arguments(parser)
    parser.add_argument('node_name', help='Name of the ROS node')
    parser.add_argument('parameter_name', help='Name of the parameter')
    parser.add_argument('value', help='Value of the parameter')


def main(args: argparse.Namespace) -> int:
    """Set it and say whether the node took it."""
    with graph.direct_node(args) as node:
        name = parameters.wait_for_node(node, args)
        parameter = Parameter(name=args.parameter_name, value=get_parameter_value(args.value))
        response = parameters.call(
            node, SetParameters, f'{name}/set_parameters',
            SetParameters.Request(parameters=[parameter]))
        result, = response.results
        reason = f': {result.reason}' if result.reason else ''
        if result.successful:
            print(f'Set parameter successful{reason}')
            return 0
        print(f'Setting parameter failed{reason}', file=sys.stderr)
    return 1
