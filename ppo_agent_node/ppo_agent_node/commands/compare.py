# SPDX-License-Identifier: Apache-2.0
"""Command `compare`: records a run's expert, clone and policy, side by side."""
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ppo_agent_node.commands import recorded_flights
from rocket_sim_node import command_line
from rocket_sim_node.printable import printable_path
from rocket_sim_node.recording.comparison import comparison
from rocket_sim_node.recording.sinks.destinations import check_suffix
from rocket_sim_node.recording.trajectories import touchdown
from rocket_sim_node.settings import setting


@dataclass(frozen=True)
class Comparison:
    """Arguments of the command."""

    run_dir: str = setting('', '', 'folder of the run')
    output: str = setting('', '', 'the recording, .rrd; empty: comparison.rrd in that folder')
    episodes: int = setting(10, '', 'starts that each pilot flies', 1, 100)
    level: int = setting(0, '', 'curriculum level; 0: the final one of the run', 0, 8)
    seed: int = setting(
        -1, '', "seed of the starts; -1: that of the run's evaluation", -1, 2**62)


def make(wanted: Comparison) -> str:
    """Write the recording; return the text to print.

    :raises OSError: when there is no such run, or the recording cannot be written.
    :raises ValueError: when an argument does not fit.
    """
    if not wanted.run_dir:
        raise ValueError('run_dir: got none, expected the folder of a run')
    run = recorded_flights.read_run(Path(wanted.run_dir))
    output = Path(wanted.output) if wanted.output else run.path / 'comparison.rrd'
    check_suffix(wanted.output or output)
    level = wanted.level or run.level
    seed = wanted.seed if wanted.seed >= 0 else run.seed
    sides, stage, remarks = recorded_flights.compare(run, wanted.episodes, level, seed)
    where = f'{run.world}, level {level}' if level else run.world
    starts = f'{wanted.episodes} equal starts' if wanted.episodes > 1 else 'one start'
    heading = (
        f'Run **{run.path.resolve().name}**, world **{where}**: {starts}, seed {seed}.')
    said = comparison.write(output, sides, stage, touchdown.follow, heading, remarks)
    size = output.stat().st_size
    return (
        f'{said.text}\ncomparison: {printable_path(output)} '
        f'({said.steps} steps, {size / 2**20:.1f} MiB); '
        f'watch it with: {command_line.watch_with(output)}\n')


def main() -> None:
    """Run the command."""
    command_line.run(
        'compare', 'run_dir:=DIR [NAME:=VALUE ...]',
        'Flies the expert, the clone and the best policy of a run from the same starts and '
        'records them side by side.', Comparison, make)


if __name__ == '__main__':
    main()
