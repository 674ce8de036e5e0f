# SPDX-License-Identifier: Apache-2.0
"""Node `evaluate`: N deterministic episodes of a pilot, as a table, JSON and plots."""
from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.executors import Executor
from rclpy.node import Node

from ppo_agent_node.evaluation import metrics
from ppo_agent_node.evaluation.optimum_sample import SAMPLE
from ppo_agent_node.nodes.connection import EXPECTED_ERRORS
from ppo_agent_node.nodes.connection import ConnectionParameters
from ppo_agent_node.nodes.connection import make_client
from ppo_agent_node.nodes.connection import require_lockstep
from ppo_agent_node.nodes.evaluating import fly_and_write
from ppo_agent_node.pilots.base import Pilot
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.pilots.random import RandomPilot
from ppo_agent_node.pilots.scripted import scripted_pilot
from ppo_agent_node.pilots.search import find_policy
from ppo_agent_node.terminal import Terminal
from rocket_sim_node.settings import setting
from rocket_sim_node.wire.parameters import Parameters
from rocket_sim_node.wire.running import leave
from rocket_sim_node.wire.running import run
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.flight import SerialFleet


@dataclass(frozen=True)
class EvaluationParameters:
    """Parameters of the node, beside those of the connection."""

    pilot: str = setting('policy', '', 'who flies', choices=('policy', 'expert', 'random'))
    policy: str = setting(
        '', '', 'policy file; empty: of the newest finished run, else the one that ships')
    episodes: int = setting(2000, '', 'shared evenly over the rockets', 1, 10_000_000)
    level: int = setting(0, '', "curriculum level; 0: the simulator's own", 0, 8)
    seed: int = setting(20_000_000, '', 'where the spawns start', 0, 2**62)
    optimum_sample: int = setting(
        SAMPLE, '', 'first episodes whose least fuel and time are solved for; 0: none', 0, 100_000)
    output: str = setting('', '', 'folder for evaluation.json and plots/; empty: no files')


def evaluation(node: Node, executor: Executor) -> None:
    """Fly the episodes and report."""
    parameters = Parameters(node)
    options = parameters.declare(EvaluationParameters)
    connection = parameters.declare(ConnectionParameters)
    parameters.finish()
    output = Path(options.output) if options.output else None
    if output:
        # Before the flight: an unwritable folder is told at once, not after minutes.
        (output / 'plots').mkdir(parents=True, exist_ok=True)
    with make_client(node, executor, connection) as client, Terminal() as terminal:
        pilot, facts = _pilot(node, options, client.connect())
        require_lockstep(client)
        summary = fly_and_write(
            SerialFleet(client), pilot, options.episodes, options.seed, options.level, output,
            terminal.show, poll=terminal.tick, optimum_sample=options.optimum_sample, **facts)
        terminal.say(metrics.table(summary))
        if output:
            terminal.say(f'evaluation.json and plots are in {output}')


def _pilot(
    node: Node, options: EvaluationParameters, spec: WorldSpec,
) -> tuple[Pilot, dict[str, Any]]:
    """Return who flies, and what the figures shall say about a policy's file.

    :raises ValueError: when a policy is named for another pilot, or does not fit the world.
    """
    if options.policy and options.pilot != 'policy':
        raise ValueError(
            f'policy: got {options.policy!r}, expected none with pilot {options.pilot!r}')
    if options.pilot == 'expert':
        return scripted_pilot(spec), {}
    if options.pilot == 'random':
        return RandomPilot(spec, options.seed), {}
    path = find_policy(options.policy, spec.name)
    pilot = PolicyPilot(path, spec)
    if pilot.unfamiliar:
        node.get_logger().warning(pilot.unfamiliar)
    return pilot, {
        'policy_file': str(path), 'policy_sha256': hashlib.sha256(path.read_bytes()).hexdigest()}


def main() -> None:
    """Run the node."""
    leave(run('evaluate', evaluation, EXPECTED_ERRORS))


if __name__ == '__main__':
    main()
