# SPDX-License-Identifier: Apache-2.0
"""The plot of `bench soak`: measurements over time."""
from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from benchmarks.reliability.soak_nodes import NODES
from benchmarks.reliability.soak_samples import Samples
from ppo_agent_node.reporting.pictures import style

_PANELS = (('own', 'memory of its own, MiB'), ('files', 'open files'), ('threads', 'threads'))


def draw(samples: Samples, iterations: Sequence[dict[str, float]], path: Path) -> Path:
    """Draw one panel per figure, with one line for each process of a node."""
    with style.styled():
        figure = Figure(figsize=(11, 9))
        axes = figure.subplots(3, 2, sharex=True).reshape(-1)
        colours = dict(zip(NODES, style.CYCLE, strict=False))
        for panel, (name, title) in zip(axes, _PANELS, strict=False):
            panel.set_title(title)
            for node in NODES:
                rows = [row for row in samples.rows if row['node'] == node]
                for life in sorted({row['life'] for row in rows}):
                    own = [row for row in rows if row['life'] == life]
                    panel.plot(
                        [row['time'] / 60 for row in own], [row[name] for row in own], lw=1.2,
                        color=colours[node], label=node if life == rows[0]['life'] else '')
        axes[3].axis('off')
        axes[3].legend(*axes[0].get_legend_handles_labels(), loc='center', title='nodes')
        for panel, name, title in (
            (axes[4], 'steps_per_second', 'rocket steps/s'),
            (axes[5], 'steps_per_piece', 'rocket steps per piece of work'),
        ):
            panel.set_title(title)
            panel.plot(
                [row['time'] / 60 for row in iterations], [row[name] for row in iterations],
                ls='', marker='.', ms=3)
            panel.set_xlabel('min')
        for panel in figure.axes:
            panel.set_ylim(bottom=0)
        minutes = max((row['time'] for row in samples.rows), default=0.0) / 60
        figure.suptitle(
            f'Memory, files and threads of each node over {minutes:.0f} min; drops are restarts',
            x=0.01, ha='left')
        return style.save(figure, path)
