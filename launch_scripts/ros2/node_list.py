# SPDX-License-Identifier: Apache-2.0
"""Output a list of available nodes."""
from __future__ import annotations

import argparse

from ros2 import graph


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    graph.add_arguments(parser)
    parser.add_argument(
        '-a', '--all', action='store_true', help='Display all nodes even hidden ones')
    parser.add_argument(
        '-c', '--count-nodes', action='store_true',
        help='Only display the number of nodes discovered')


def main(args: argparse.Namespace) -> None:
    """Print one node a line."""
    with graph.direct_node(args) as node:
        graph.look_around(node, args)
        names = graph.node_names(node, args.all)
        if args.count_nodes:
            print(len(names))
            return
        graph.warn_about_duplicates(names)
        for name in names:
            print(name)
