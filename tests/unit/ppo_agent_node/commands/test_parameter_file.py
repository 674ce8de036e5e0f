# SPDX-License-Identifier: Apache-2.0
"""Files of ROS parameters: which sections are for a node."""
from __future__ import annotations

from pathlib import Path

import pytest

from ppo_agent_node.commands.parameter_file import read_parameters
from ppo_agent_node.commands.parameter_file import write_parameters

NODES = ('/simulator', '/ns/simulator', '/x/ns/simulator', '/ns/y/simulator')


@pytest.mark.parametrize(('keys', 'nodes'), [
    # As rclpy of ROS 2 Kilted gives them.
    (['/**'], NODES), (['**'], NODES), (['/**/simulator'], NODES), (['/**', 'simulator'], NODES),
    (['simulator'], NODES[:1]), (['/simulator'], NODES[:1]), (['/*'], NODES[:1]),
    (['*'], NODES[:1]), (['/ns/simulator'], NODES[1:2]), (['/ns', 'simulator'], NODES[1:2]),
    (['ns', 'simulator'], NODES[1:2]), (['/*/simulator'], NODES[1:2]), (['/ns/*'], NODES[1:2]),
    (['/ns/**'], [NODES[1], NODES[3]]), (['/ns/**/simulator'], [NODES[1], NODES[3]]),
    (['simulater'], []), (['/other/simulator'], []), (['/sim.lator'], [])])
def test_sections_are_for_the_nodes_that_rcl_gives_them_to(
        tmp_path: Path, keys: list[str], nodes: list[str]) -> None:
    content = 'ros__parameters: {a: 1}'
    for key in reversed(keys):
        content = f"'{key}': {{{content}}}"
    (tmp_path / 'file.yaml').write_text(content)
    assert [node for node in NODES if read_parameters(tmp_path / 'file.yaml', node)] == [*nodes]


def test_values_are_written_where_the_node_finds_them(tmp_path: Path) -> None:
    base, path = tmp_path / 'base.yaml', tmp_path / 'file.yaml'
    base.write_text('/ns/simulator: {ros__parameters: {a: 1}}\n'
                    '/other: {ros__parameters: {a: 1}}\n/**: {ros__parameters: {a: 2, b: 2}}\n')
    write_parameters(path, '/ns/simulator', {'a': 3}, base)
    assert read_parameters(path, '/ns/simulator') == {'a': 3, 'b': 2}
    assert read_parameters(path, '/other') == {'a': 3, 'b': 2}
