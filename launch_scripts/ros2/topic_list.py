# SPDX-License-Identifier: Apache-2.0
"""Output a list of available topics."""
from __future__ import annotations

import argparse

from ros2 import graph


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    graph.add_arguments(parser)
    parser.add_argument(
        '-t', '--show-types', action='store_true', help='Additionally show the topic type')
    parser.add_argument(
        '-c', '--count-topics', action='store_true',
        help='Only display the number of topics discovered')
    parser.add_argument(
        '--include-hidden-topics', action='store_true', help='Consider hidden topics as well')
    parser.add_argument(
        '-v', '--verbose', action='store_true', help='List full details about each topic')


def _details(title: str, role: str, rows: list[tuple[str, list[str], int]]) -> str:
    lines = [f'{title} topics:']
    for name, types, count in rows:
        if count:
            plural = 's' if count > 1 else ''
            lines.append(f' * {name} [{", ".join(types)}] {count} {role}{plural}')
    return '\n'.join(lines) + '\n'


def main(args: argparse.Namespace) -> None:
    """Print one topic a line."""
    with graph.direct_node(args) as node:
        graph.look_around(node, args)
        topics = sorted(
            (name, types) for name, types in node.get_topic_names_and_types()
            if args.include_hidden_topics or not graph.is_hidden(name))
        if args.count_topics:
            print(len(topics))
        elif args.verbose:
            print(_details('Published', 'publisher', [
                (name, types, node.count_publishers(name)) for name, types in topics]))
            print(_details('Subscribed', 'subscriber', [
                (name, types, node.count_subscribers(name)) for name, types in topics]))
        else:
            for name, types in topics:
                print(f'{name} [{", ".join(types)}]' if args.show_types else name)
