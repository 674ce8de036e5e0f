# SPDX-License-Identifier: Apache-2.0
"""Writes docs/results/performance.md and its plots from the figures of the benchmarks.

The newest figures of each part below `runs/` are used, with a line about the machine. If a part
has no figures, its section stays as it is on the page.
"""
from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.reports import performance_plots
from benchmarks.reports.performance_text import SECTIONS
from ppo_agent_node.atomic_file import write_atomically

_HEAD = """# Performance

This page shows the cost of each part, compared with a lower bound (its floor) and with peers
(comparable libraries). `./launch_scripts/bench performance` writes it from the newest figures of
each part, which were measured with `./launch_scripts/bench` (all of this page) or
`./launch_scripts/bench PART`. The figures are in `runs/bench-DATE/PART.json`.

Messages go over UDP since 1eb9344 (2026-11-25). Sections with an earlier date were measured with
shared memory ([a comparison](../explanation/fast-dds.md#why-not-shared-memory)).

Peers and this project are measured alternately, in one run. The machine is shared and its speed
varies, so ratios are more reliable than seconds. A commit that ends in `-dirty` had uncommitted
changes.
"""


def newest(runs: Path, part: str, world: str = '') -> Path | None:
    """Return the newest file with figures of a part, and of a world if one is named, or None."""
    found = [path for path in sorted(runs.glob(f'bench-*/{part}.json'))
             if not world or world in json.loads(path.read_text('utf-8'))]
    return found[-1] if found else None


def machine_line(folder: Path) -> str:
    """Return one line about the machine on which a part was measured."""
    path = folder / 'machine.json'
    if not path.exists():
        return ''
    m: dict[str, Any] = json.loads(path.read_text('utf-8'))
    versions = ', '.join(
        f'{name} {text}' for name, text in m['versions'].items() if text != 'missing')
    return (f"{m['date']}, commit {m['commit']}: {m['cores']} cores of {m['processor']}, "
            f"{m['memory_gib']} GiB, {m['system']}; {versions}.")


def plots(
    path: Path, figures: dict[str, Any], images: Path, world: str = '',
) -> list[Path]:
    """Write the plots of a part to a folder: its own plots if it drew any, otherwise ours.

    :param world: only its own plots for this world.
    """
    part = path.stem
    drawn = []
    for own in sorted(path.parent.glob(f'{part}_{world}*.png')):
        drawn.append(images / f'performance_{own.name}')
        write_atomically(drawn[-1], own.read_bytes())
    if not drawn and performance_plots.draw(
            part, figures, images / f'performance_{part}.png'):
        drawn.append(images / f'performance_{part}.png')
    return drawn


def sections(runs: Path, images: Path, page: str) -> Iterator[str]:
    """Yield the sections of the page, and draw their plots into a folder.

    :param page: the present text.
    """
    there = {
        section.partition('\n')[0]: f'## {section.rstrip()}\n'
        for section in re.split('^## ', page, flags=re.MULTILINE)[1:]}
    for name, (title, text) in SECTIONS.items():
        part, _, world = name.partition(' of ')
        path = newest(runs, part, world)
        if path is None:
            yield there.get(
                title, f'## {title}\n\nNot measured: `./launch_scripts/bench {part}`.\n')
            continue
        figures = json.loads(path.read_text('utf-8'))
        table = path.with_suffix('.txt').read_text('utf-8').rstrip()
        command = path.with_suffix('.command').read_text('utf-8').strip()
        try:
            said, drawn = text(figures), plots(path, figures, images, world)
        except (KeyError, TypeError) as error:
            print(f'{part}: left as it is: {path} is of an older benchmark: {error!r}')
            yield there.get(
                title, f'## {title}\n\nMeasure again: `./launch_scripts/bench {part}`.\n')
            continue
        lines = [f'## {title}', '', said, '', f'`{command}`:', '', '```', table, '```', '']
        for plot in drawn:
            lines += [f'![{title}](../images/{plot.name})', '']
        lines.append(machine_line(path.parent))
        yield '\n'.join(lines).rstrip() + '\n'


def main() -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(
        prog='bench performance', description=__doc__.split('\n')[0])
    parser.add_argument('--runs', type=Path, default=Path('runs'), help='folder of the figures')
    parser.add_argument('--page', type=Path, default=Path('docs/results/performance.md'),
                        help='page to write')
    options = parser.parse_args()
    images = options.page.parents[1] / 'images'
    images.mkdir(parents=True, exist_ok=True)
    before = options.page.read_text('utf-8') if options.page.exists() else ''
    page = '\n'.join([_HEAD, *sections(options.runs, images, before)])
    write_atomically(options.page, page.encode())
    print(f'written: {options.page}')


if __name__ == '__main__':
    main()
