# SPDX-License-Identifier: Apache-2.0
"""An evaluation as the nodes do it: flown, told, and written to a folder."""
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
from ppo_agent_node.runs.status import Status
from rocket_sim_node.wire.node import stopping
from rocket_sim_node.worlds.jobs import Fleet

_REPORTS = 20
"""reports of progress, at most"""


def fly_and_write(
    fleet: Fleet, pilot: Pilot, episodes: int, seed: int, level: int, folder: Path | None,
    report: Callable[[Status], None], run: str = '', poll: Callable[[], None] = lambda: None,
    optimum_sample: int = SAMPLE, settings: Mapping[str, float] | None = None, **extra: Any,
) -> dict[str, Any]:
    """Evaluate a pilot and return the figures; a simulator that restarts is flown anew.

    :param level: curriculum level, 0: the simulator's own.
    :param folder: where `evaluation.json`, `episodes.csv`, `plots/` and `report.html` go, the
        last two with what else the folder holds of a run; None: nowhere.
    :param poll: called before each step.
    :param optimum_sample: how many starts to solve for their optimum; 0: none.
    :param settings: what else the world is reset with, such as conditions.
    :param extra: facts to be kept with the figures.
    """
    start = time.monotonic()
    told = 0
    flown_level = level or int(fleet.spec.settings.get('level', 0))

    def progress(done: int, total: int) -> None:
        nonlocal told
        if done * _REPORTS // total > told:
            told = done * _REPORTS // total
            elapsed = time.monotonic() - start
            report(Status(
                run=run, stage='evaluate', iteration=done, iterations=total, level=flown_level,
                elapsed=elapsed, remaining=elapsed / done * (total - done)))

    def anew(message: str) -> None:
        nonlocal told
        told = 0
        report(Status(run=run, stage='evaluate', level=flown_level, message=message))

    (result,) = fleet.fly([functools.partial(
        evaluation_flight, fleet.spec, pilot, episodes, seed, progress,
        **{**(settings or {}), **level_setting(level)})],
        poll=poll, report=anew)
    report(Status(
        run=run, stage='evaluate', iteration=episodes, iterations=episodes, level=flown_level,
        message='flown; working out figures and plots'))

    def write() -> dict[str, Any]:
        optimum = solve_sample(result, optimum_sample)
        summary = metrics.summarise(result, **optimum.figures(result), **extra)
        if folder is not None:
            # Of an evaluation before: it would not be of the same flights.
            (folder / 'episodes.csv').unlink(missing_ok=True)
            metrics.write_json(folder / 'evaluation.json', summary)
            episode_table.write(
                folder / 'episodes.csv', episode_table.from_result(result, optimum))
            # It draws, and what draws takes its time to import: not before a run can begin.
            from ppo_agent_node.commands.report import write_report

            write_report(folder)
        return summary

    return stopping.abandonable(write)
