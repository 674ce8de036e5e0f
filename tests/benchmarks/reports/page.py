# SPDX-License-Identifier: Apache-2.0
"""Writes the results of an experiment to its section of docs/results/experiments.md.

A section has its figures between two comments, `<!-- NAME -->` and `<!-- end of NAME -->`. The
text around them is written by hand and is not changed.
"""
from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ppo_agent_node.atomic_file import write_atomically


def write(page: Path, picture: Path, name: str, figures: Mapping[str, Any], table: str) -> None:
    """Replace the figures of an experiment on the page, and copy its picture to docs/images.

    :param table: Markdown.
    :raises ValueError: if the page has no section for the experiment.
    """
    image = keep_picture(page, picture, f'experiments_{name}.png')
    put(page, name, '\n\n'.join((facts(figures), table, (
        f'![{figures["finding"]}](../images/{image})'))))


def keep_picture(page: Path, picture: Path, name: str) -> str:
    """Copy a picture to docs/images for a page in a folder of docs; return its name."""
    write_atomically(page.parents[1] / 'images' / name, picture.read_bytes())
    return name


def put(page: Path, name: str, block: str) -> None:
    """Replace a section of a page.

    :param block: Markdown.
    :raises ValueError: if the page has no such section.
    """
    text = page.read_text('utf-8')
    begin, end = f'<!-- {name} -->\n', f'<!-- end of {name} -->'
    if text.count(begin) != 1 or text.count(end) != 1:
        raise ValueError(f'{page}: expected {begin.strip()} and {end} once each')
    before, _, rest = text.partition(begin)
    after = rest.partition(end)[2]
    write_atomically(page, f'{before}{begin}{block}\n{end}{after}'.encode())


def facts(figures: Mapping[str, Any]) -> str:
    """Return one line with command, date, commits, seeds and machine of the figures."""
    machine, cpu = figures['machine'], figures['cpu_seconds']
    trained = ''
    if figures['runs']:
        seeds = ', '.join(map(str, figures['training_seeds']))
        commits = ', '.join(sorted({run['commit'] for run in figures['runs']}))
        trained = (f'training seeds {seeds} at {commits}, {len(figures["runs"])} runs, '
                   f'{cpu["training"]:.0f} s of processor time; ')
    return (f'`{figures["command"]}`: {machine["date"]}, commit {machine["commit"]}; {trained}'
            f'{figures["episodes"]} episodes of each task, seed {figures["flight_seed"]}; '
            f'{machine["processor"]}.')
