# SPDX-License-Identifier: Apache-2.0
"""Nodes: their names."""
from __future__ import annotations

import argparse
import sys

from ros2 import graph
from ros2.verb import Verb


def names(args: argparse.Namespace) -> None:
    """Print one node a line."""
    with graph.direct_node() as node:
        graph.look_around(node)
        found = graph.node_names(node)
        if len(set(found)) < len(found):
            print('WARNING: Be aware that there are nodes in the graph that share an exact name, '
                  'which can have unintended side effects.', file=sys.stderr)
        for name in found:
            print(name)


VERBS = {'list': Verb('Output a list of available nodes', names)}
