# SPDX-License-Identifier: Apache-2.0
"""Command `report`: pictures and a page of one run, or a comparison of several."""
from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from ppo_agent_node.atomic_file import write_atomically
from ppo_agent_node.reporting.pages.comparison_page import comparison_page
from ppo_agent_node.reporting.pages.run_page import REPORT
from ppo_agent_node.reporting.pages.run_page import run_page
from ppo_agent_node.reporting.pictures import catalogue
from ppo_agent_node.reporting.pictures import learning_curves
from ppo_agent_node.reporting.pictures import style
from ppo_agent_node.reporting.run_files import Run
from ppo_agent_node.reporting.run_files import load
from ppo_agent_node.runs.new_paths import new_folder
from rocket_sim_node import command_line
from rocket_sim_node.printable import printable_path
from rocket_sim_node.settings import setting

PLOTS = 'plots'


@dataclass(frozen=True)
class Options:
    """Arguments of the command, beside the folders."""

    output: str = setting(
        '', '', 'folder for the comparison of several runs; empty: report-DATE beside the first')


def write_report(folder: Path) -> Path:
    """Draw a folder's pictures into its `plots/`, write its page and return the page's path.

    :param folder: of a training run, of an evaluation, or of an unfinished run.
    :raises ValueError: when it is not a run, or a file is damaged; the message names it.
    :raises OSError: when something cannot be read or written.
    """
    return _write(load(folder))


def remove_report(folder: Path, sections: Sequence[str]) -> None:
    """Remove the page and the pictures of some of its sections from a folder, if it has them.

    :raises OSError: when something cannot be removed.
    """
    for name, entry in catalogue.CATALOGUE.items():
        if entry.section in sections:
            (folder / PLOTS / f'{name}.png').unlink(missing_ok=True)
    (folder / REPORT).unlink(missing_ok=True)


def _write(run: Run) -> Path:
    """Draw and write a run's report, and return its path."""
    drawn = catalogue.draw(run, run.path / PLOTS)
    path = run.path / REPORT
    write_atomically(path, run_page(run, drawn).encode())
    return path


def write_comparison(runs: Sequence[Run], folder: Path) -> Path:
    """Draw learning curves over the seeds of runs, write a page and return its path.

    :raises OSError: when something cannot be written.
    """
    (folder / PLOTS).mkdir(parents=True, exist_ok=True)
    groups = learning_curves.groups(runs)
    curves = None
    with style.styled():
        figure = learning_curves.seeds_figure(groups)
        if figure is not None:
            curves = style.save(figure, folder / PLOTS / 'seeds.png')
    path = folder / REPORT
    write_atomically(path, comparison_page(groups, curves, folder).encode())
    return path


def _report(arguments: Sequence[str]) -> None:
    """Draw and write the requested reports.

    :raises ValueError: or TypeError, for bad arguments; OSError for files.
    """
    options = command_line.parse(Options, [one for one in arguments if ':=' in one])
    folders = list(dict.fromkeys(Path(one) for one in arguments if ':=' not in one))
    if not folders:
        raise ValueError('got no RUN, expected the folder of a run or an evaluation')
    if options.output and len(folders) < 2:
        raise ValueError(f'output: got {options.output!r}, expected none with one RUN')
    # All of them, and the folder of the comparison, before any is drawn: that takes a while.
    runs = [load(folder) for folder in folders]
    output = _folder(options.output, runs[0]) if len(runs) > 1 else None
    for run in runs:
        sys.stdout.write(f'{printable_path(_write(run))}\n')
    if output is not None:
        sys.stdout.write(f'{printable_path(write_comparison(runs, output))}\n')


def _folder(name: str, first: Run) -> Path:
    """Make the folder of a comparison and return its path.

    :param name: as given; empty: a new one beside the first run.
    :raises ValueError: when it cannot be made, or written.
    """
    if not name:
        return new_folder(
            first.path.resolve().parent / f'report-{datetime.now():%Y%m%d-%H%M%S}')
    plots = Path(name) / PLOTS
    try:
        plots.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(
            f'output: got {name!r}, expected a folder that can be made: {error.strerror}'
        ) from error
    if not (os.access(name, os.W_OK | os.X_OK) and os.access(plots, os.W_OK | os.X_OK)):
        raise ValueError(f'output: got {name!r}, expected a folder that is writable')
    return Path(name)


def main() -> None:
    """Run the command."""
    arguments = sys.argv[1:]
    usage = command_line.usage(
        'report', 'RUN [RUN ...] [NAME:=VALUE ...]',
        'Draws the pictures of training runs and evaluations into RUN/plots and writes\n'
        'RUN/report.html, one page that holds them with figures and settings. For several\n'
        'runs it also compares the learning curves over seeds.', Options)
    if not command_line.tell_usage(usage, arguments):
        return
    try:
        with command_line.interruptible():
            _report(arguments)
    except (ValueError, TypeError, OSError) as error:
        command_line.fail('report', error)


if __name__ == '__main__':
    main()
