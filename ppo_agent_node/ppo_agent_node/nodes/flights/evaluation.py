# SPDX-License-Identifier: Apache-2.0
"""Evaluation by a node: flights, progress reports and files."""
from __future__ import annotations

import functools
import time
from collections.abc import Callable
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ppo_agent_node.config.curriculum_config import level_setting
from ppo_agent_node.evaluation import episode_table
from ppo_agent_node.evaluation import metrics
from ppo_agent_node.evaluation.optimum_sample import SAMPLE
from ppo_agent_node.evaluation.optimum_sample import solve_sample
from ppo_agent_node.evaluation.runner import evaluation_flight
from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.nodes.flights.report import remove_report
from ppo_agent_node.nodes.flights.report import write_report
from rocket_sim_node.telemetry.training_status import Status
from rocket_sim_node.wire.node import stopping
from rocket_sim_node.worlds.jobs import Fleet

_REPORTS = 20
"""Maximum number of progress reports."""


def fly_and_write(
    fleet: Fleet, pilot: Pilot, episodes: int, seed: int, level: int, folder: Path | None,
    report: Callable[[Status], None], run: str = '', poll: Callable[[], None] = lambda: None,
    optimum_sample: int = SAMPLE, settings: Mapping[str, float] | None = None, plots: bool = True,
    sections: tuple[str, ...] = ('Evaluation',), **extra: Any,
) -> dict[str, Any]:
    """Evaluate a pilot and return the figures; restarts if the simulator does.

    :param level: curriculum level, 0: the simulator's own.
    :param folder: destination of `evaluation.json`, `episodes.csv`, `plots/` and `report.html`;
        the last two include other files of a run in the folder. None: no files.
    :param poll: called before each step.
    :param optimum_sample: number of starts to solve for their optimum; 0: none.
    :param settings: further reset settings, such as conditions.
    :param plots: write `plots/` and `report.html` as well.
    :param sections: of `report.html`, whose earlier pictures are removed first.
    :param extra: facts to store with the figures.
    """
    start = time.monotonic()
    reported = 0
    dropped = fleet.messages_dropped
    flown_level = level or int(fleet.spec.settings.get('level', 0))

    def progress(done: int, total: int) -> None:
        nonlocal reported
        if done * _REPORTS // total > reported:
            reported = done * _REPORTS // total
            elapsed = time.monotonic() - start
            report(Status(
                run=run, stage='evaluate', iteration=done, iterations=total, level=flown_level,
                elapsed=elapsed, remaining=elapsed / done * (total - done)))

    def anew(message: str) -> None:
        nonlocal reported
        reported = 0
        report(Status(run=run, stage='evaluate', level=flown_level, message=message))

    (result,) = fleet.fly([functools.partial(
        evaluation_flight, fleet.spec, pilot, episodes, seed, progress,
        **{**(settings or {}), **level_setting(level)})],
        poll=poll, report=anew)
    report(Status(
        run=run, stage='evaluate', iteration=episodes, iterations=episodes, level=flown_level,
        message='all flown; computing figures' + (' and plots' if plots else '')))

    def write() -> dict[str, Any]:
        optimum = solve_sample(result, optimum_sample)
        summary = metrics.summarise(
            result, **optimum.figures(result),
            messages_dropped=fleet.messages_dropped - dropped, **extra)
        if folder is not None:
            # From an earlier evaluation: its pictures and episodes would not match.
            remove_report(folder, sections)
            (folder / 'episodes.csv').unlink(missing_ok=True)
            metrics.write_json(folder / 'evaluation.json', summary)
            episode_table.write(
                folder / 'episodes.csv', episode_table.from_result(result, optimum))
            if plots:
                write_report(folder)
        return summary

    return stopping.abandonable(write)
