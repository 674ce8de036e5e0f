# SPDX-License-Identifier: Apache-2.0
"""Node `evaluate`: deterministic episodes of a pilot, reported as a table, JSON and plots."""
from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from rclpy.executors import Executor
from rclpy.node import Node

from ppo_agent_node.evaluation import conditions_files
from ppo_agent_node.evaluation import conditions_table
from ppo_agent_node.evaluation import metrics
from ppo_agent_node.evaluation.optimum_sample import SAMPLE
from ppo_agent_node.nodes.flights.conditions_table import fly_and_write_table
from ppo_agent_node.nodes.flights.connection import EXPECTED_ERRORS
from ppo_agent_node.nodes.flights.connection import ConnectionParameters
from ppo_agent_node.nodes.flights.connection import make_client
from ppo_agent_node.nodes.flights.connection import require_lockstep
from ppo_agent_node.nodes.flights.evaluation import fly_and_write
from ppo_agent_node.pilots import choice
from ppo_agent_node.pilots.choice import Chosen
from ppo_agent_node.terminal import Terminal
from rocket_sim_node.settings import setting
from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.node.parameters import ParameterError
from rocket_sim_node.wire.node.parameters import Parameters
from rocket_sim_node.wire.node.running import leave
from rocket_sim_node.wire.node.running import run
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.jobs import SerialFleet
from rocket_sim_node.worlds.rocket import conditions

ALL = 'all'
_EPISODES = 2000
_DONE = 'HOVERSLAM_DONE'
"""Names the file by which launch_scripts/evaluate learns that all is flown and written."""


@dataclass(frozen=True)
class EvaluationParameters:
    """Parameters of the node, beside those of the connection."""

    pilot: str = setting('policy', '', 'pilot to evaluate', choices=choice.NAMES)
    policy: str = setting(
        '', '', 'policy file, ONNX file, or name of a shipped policy; empty: the policy of the '
        'newest finished run, or the shipped policy for the world if there is no run')
    pilots: str = setting(
        '', '', 'pilots of the table, separated by commas: policy, expert, expert_estimator, '
        'random, names of shipped policies, files; empty: that of parameter pilot, and the expert')
    conditions: str = setting(
        '', '', "set of conditions; empty: the simulator's own; all: the whole table of "
        'conditions on levels 7 and 8', choices=('', *conditions.NAMES, ALL))
    episodes: int = setting(
        0, '', f'number of episodes, shared evenly among the rockets; 0: {_EPISODES}, or '
        f'{conditions_table.EPISODES} per cell of the table', 0, 10_000_000)
    level: int = setting(
        0, '', "curriculum level; 0: the simulator's own, or 7 and 8 for the table", 0, 8)
    seed: int = setting(conditions_table.SEED, '', 'seed of the starts', 0, 2**62)
    optimum_sample: int = setting(
        SAMPLE, '', 'number of episodes, from the first, for which the optimum of fuel and time '
        'is computed; 0: none', 0, 100_000)
    output: str = setting('', '', 'folder for figures and plots; empty: no files are written')
    plots: bool = setting(
        True, '', 'also draw plots and write a report to that folder, which takes seconds')


def evaluation(node: Node, executor: Executor) -> None:
    """Fly the episodes and report."""
    parameters = Parameters(node)
    options = parameters.declare(EvaluationParameters)
    connection = parameters.declare(ConnectionParameters)
    parameters.finish()
    _check(options)
    output = Path(options.output) if options.output else None
    if output:
        # Before the flight, so that an unwritable folder is reported at once.
        (output / 'plots' if options.plots else output).mkdir(parents=True, exist_ok=True)
    with make_client(node, executor, connection) as client, Terminal() as terminal:
        settings = _settings(options, client.connect())
        # A scripted pilot knows the kind of vehicle, but not the drawn conditions.
        chosen = _chosen(options, client.spec.after_reset(settings))
        for one in chosen:
            if one.warning:
                node.get_logger().warning(one.warning)
        require_lockstep(client)
        if options.conditions == ALL:
            _table(client, chosen, options, output, terminal)
        else:
            _single(client, chosen[0], options, settings, output, terminal)
    if done := os.environ.get(_DONE):
        Path(done).touch()


def _check(options: EvaluationParameters) -> None:
    """Check parameters that depend on each other.

    :raises ParameterError: naming the one that does not fit.
    """
    if options.policy and options.pilot != choice.POLICY:
        raise ParameterError(
            f'policy: got {options.policy!r}, expected none with pilot {options.pilot!r}')
    if options.conditions == ALL and options.optimum_sample not in (SAMPLE, 0):
        raise ParameterError(
            f'optimum_sample: got {options.optimum_sample}, expected none with conditions '
            f'{ALL!r}, whose table has no optimum')
    if not options.pilots:
        return
    if options.conditions != ALL:
        raise ParameterError(
            f'pilots: got {options.pilots!r}, expected none without conditions {ALL!r}')
    if options.pilot != choice.POLICY:
        raise ParameterError(
            f'pilot: got {options.pilot!r}, expected none beside pilots, {options.pilots!r}')
    if options.policy and choice.POLICY not in _names(options):
        raise ParameterError(
            f"policy: got {options.policy!r}, expected none, as 'policy' is not among pilots, "
            f'{options.pilots!r}')


def _names(options: EvaluationParameters) -> list[str]:
    """Return the names of the pilots."""
    if options.pilots:
        return [name.strip() for name in options.pilots.split(',') if name.strip()]
    with_expert = options.conditions == ALL and options.pilot != choice.EXPERT
    return [options.pilot, *([choice.EXPERT] if with_expert else [])]


def _settings(options: EvaluationParameters, spec: WorldSpec) -> dict[str, float]:
    """Return the reset settings for the conditions of an evaluation.

    :raises ValueError: for a world that has none.
    """
    if not options.conditions:
        return {}
    conditions.check_world(spec, options.conditions)
    return {} if options.conditions == ALL else conditions.settings(options.conditions)


def _chosen(options: EvaluationParameters, spec: WorldSpec) -> list[Chosen]:
    """Return the pilots, one or more.

    :raises ValueError: when one does not fit the world, or none is named.
    """
    names = _names(options)
    if not names:
        raise ParameterError(f'pilots: got {options.pilots!r}, expected one or more names')
    return choice.choose_all(names, spec, options.seed, options.policy)


def _single(
    client: Client, chosen: Chosen, options: EvaluationParameters, settings: dict[str, float],
    output: Path | None, terminal: Terminal,
) -> None:
    """Evaluate one pilot."""
    summary = fly_and_write(
        SerialFleet(client), chosen.pilot, options.episodes or _EPISODES, options.seed,
        options.level, output, terminal.show, poll=terminal.tick, settings=settings,
        optimum_sample=options.optimum_sample, plots=options.plots, sections=('Evaluation',),
        **chosen.facts)
    terminal.say(metrics.table(summary))
    if output:
        what = 'evaluation.json and plots are' if options.plots else 'evaluation.json is'
        terminal.say(f'{what} in {output}')


def _table(
    client: Client, chosen: list[Chosen], options: EvaluationParameters, output: Path | None,
    terminal: Terminal,
) -> None:
    """Fly the table of conditions."""
    levels = (options.level,) if options.level else conditions_table.LEVELS
    table = fly_and_write_table(
        SerialFleet(client), chosen, options.episodes or conditions_table.EPISODES, options.seed,
        levels, output, terminal.show, terminal.tick, options.plots)
    terminal.say(conditions_files.markdown(table))
    if output:
        what = '.md, .csv and plots' if options.plots else '.md and .csv'
        terminal.say(f'conditions.json, {what} are in {output}')


def main() -> None:
    """Run the node."""
    leave(run('evaluate', evaluation, EXPECTED_ERRORS))


if __name__ == '__main__':
    main()
