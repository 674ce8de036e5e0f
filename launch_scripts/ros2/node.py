# SPDX-License-Identifier: Apache-2.0
"""Nodes: their names."""
from __future__ import annotations

import argparse

from ros2 import graph
from ros2.verb import Verb


def names(args: argparse.Namespace) -> None:
    """Print one node a line."""
    with graph.direct_node() as node:
        graph.look_around(node)
        found = graph.node_names(node)
        graph.warn_about_duplicates(found)
        for name in found:
            print(name)


VERBS = {'list': Verb('Output a list of available nodes', names)}
