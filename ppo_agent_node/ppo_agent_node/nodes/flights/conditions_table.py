# SPDX-License-Identifier: Apache-2.0
"""Table of conditions by a node: flights, progress reports and files."""
from __future__ import annotations

import time
from collections.abc import Callable
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ppo_agent_node.evaluation import conditions_files
from ppo_agent_node.evaluation import conditions_table
from ppo_agent_node.evaluation.conditions_table import Cell
from ppo_agent_node.nodes.flights.report import remove_report
from ppo_agent_node.nodes.flights.report import write_report
from ppo_agent_node.pilots.choice import Chosen
from rocket_sim_node.telemetry.training_status import Status
from rocket_sim_node.wire.node import stopping
from rocket_sim_node.worlds.jobs import Fleet

_PERIOD = 0.5
"""Minimum seconds between progress reports."""


def fly_and_write_table(
    fleet: Fleet, chosen: Sequence[Chosen], episodes: int, seed: int, levels: Sequence[int],
    folder: Path | None, report: Callable[[Status], None],
    poll: Callable[[], None] = lambda: None, plots: bool = True,
) -> dict[str, Any]:
    """Fly pilots under all conditions and return the table.

    :param episodes: of each cell.
    :param folder: destination of `conditions.json`, `.md`, `.csv`, `plots/` and `report.html`;
        the last two include other files of a run in the folder. None: no files.
    :param poll: called before each step.
    :param plots: write `plots/` and `report.html` as well.
    :raises ValueError: for a world that has no conditions.
    """
    start = reported = time.monotonic()

    def progress(cell: Cell, done: int, total: int) -> None:
        nonlocal reported
        now = time.monotonic()
        if now - reported < _PERIOD and done < total:
            return
        reported = now
        report(Status(
            run=f'{cell.pilot}, {cell.condition}', stage='evaluate', iteration=done,
            iterations=total, level=cell.level, elapsed=now - start,
            remaining=(now - start) / done * (total - done)))

    def anew(message: str) -> None:
        report(Status(stage='evaluate', message=message, elapsed=time.monotonic() - start))

    table = conditions_table.fly_table_with(
        fleet, {one.label: one.pilot for one in chosen}, episodes, seed, levels,
        progress=progress, poll=poll, report=anew)
    table['policies'] = {one.label: one.facts for one in chosen if one.facts}

    def write() -> None:
        if folder is not None:
            # From an earlier table: its pictures would not match.
            remove_report(folder, ('Conditions',))
            conditions_files.write(folder, table)
            if plots:
                write_report(folder)

    stopping.abandonable(write)
    return table
