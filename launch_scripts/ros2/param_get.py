# SPDX-License-Identifier: Apache-2.0
"""Get parameter."""
from __future__ import annotations

import argparse

from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python

from ros2 import graph
from ros2 import parameters
from ros2.errors import CommandError

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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parameters.add_arguments(parser)
    parser.add_argument('node_name', help='Name of the ROS node')
    parser.add_argument('parameter_name', help='Name of the parameter')
    parser.add_argument('--hide-type', action='store_true', help='Hide the type information')


def main(args: argparse.Namespace) -> None:
    """Print the value."""
    with graph.direct_node(args) as node:
        name = parameters.wait_for_node(node, args)
        request = GetParameters.Request(names=[args.parameter_name])
        response = parameters.call(node, GetParameters, f'{name}/get_parameters', request)
        if not response.values:
            raise CommandError('Parameter not set')
        value = response.values[0]
        if value.type == ParameterType.PARAMETER_NOT_SET:
            print('Parameter not set.')
            return
        plain = parameter_value_to_python(value)
        plain = list(plain) if hasattr(plain, 'tolist') else plain
        print(plain if args.hide_type else f'{_LABELS[value.type]} {plain}')
