# SPDX-License-Identifier: Apache-2.0
"""Output a list of available parameters."""
from __future__ import annotations

import argparse
import re

from rcl_interfaces.srv import ListParameters

from ros2 import graph
from ros2 import parameters


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parameters.add_arguments(parser)
    parser.add_argument('node_name', nargs='?', help='Name of the ROS node')
    parser.add_argument(
        '--filter', help='Only parameters matching the regex expression will be showed.')
    parser.add_argument(
        '--param-prefixes', nargs='+', default=[],
        help='Only list parameters with the provided prefixes')


def main(args: argparse.Namespace) -> None:
    """Print one parameter a line."""
    with graph.direct_node(args) as node:
        if args.node_name:
            names = [parameters.wait_for_node(node, args)]
        else:
            graph.look_around(node, args)
            names = sorted(set(graph.node_names(node, args.include_hidden_nodes)))
        for name in names:
            request = ListParameters.Request(prefixes=args.param_prefixes)
            response = parameters.call(node, ListParameters, f'{name}/list_parameters', request)
            found = sorted(
                x for x in response.result.names if not args.filter or re.match(args.filter, x))
            if not args.node_name and found:
                print(f'{name}:')
            for parameter in found:
                print(f'  {parameter}')
