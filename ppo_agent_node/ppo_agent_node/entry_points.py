# SPDX-License-Identifier: Apache-2.0
"""The programs of this package: each runs a node, or tells which module it lacks."""
from __future__ import annotations

from rocket_sim_node.entry_points import run


def ppo_agent() -> None:
    """Run node `ppo_agent`."""
    run('ppo_agent_node.nodes.ppo_agent')


def expert_pilot() -> None:
    """Run node `expert_pilot`."""
    run('ppo_agent_node.nodes.expert_pilot')


def keyboard_pilot() -> None:
    """Run node `keyboard_pilot`."""
    run('ppo_agent_node.nodes.keyboard_pilot')


def random_pilot() -> None:
    """Run node `random_pilot`."""
    run('ppo_agent_node.nodes.random_pilot')


def evaluate() -> None:
    """Run node `evaluate`."""
    run('ppo_agent_node.nodes.evaluate')


def watch() -> None:
    """Run node `watch`."""
    run('ppo_agent_node.nodes.watch')


def action_server() -> None:
    """Run node `action_server`."""
    run('ppo_agent_node.nodes.action_server')
