# SPDX-License-Identifier: Apache-2.0
"""Output a list of available services."""
from __future__ import annotations

import argparse

from ros2 import graph


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    graph.add_arguments(parser)
    parser.add_argument(
        '-t', '--show-types', action='store_true', help='Additionally show the service type')
    parser.add_argument(
        '-c', '--count-services', action='store_true',
        help='Only display the number of services discovered')
    parser.add_argument(
        '--include-hidden-services', action='store_true', help='Consider hidden services as well')


def main(args: argparse.Namespace) -> None:
    """Print one service a line."""
    with graph.direct_node(args) as node:
        graph.look_around(node, args)
        services = sorted(
            (name, types) for name, types in node.get_service_names_and_types()
            if args.include_hidden_services or not graph.is_hidden(name))
        if args.count_services:
            print(len(services))
            return
        for name, types in services:
            print(f'{name} [{", ".join(types)}]' if args.show_types else name)
