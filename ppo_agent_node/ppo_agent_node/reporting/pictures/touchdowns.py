# SPDX-License-Identifier: Apache-2.0
"""Pictures of touchdowns: speed, tilt, position and fuel."""
from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from ppo_agent_node.evaluation.episode_table import EpisodeTable
from ppo_agent_node.evaluation.runner import IN_FLIGHT
from ppo_agent_node.reporting.pictures import style
from ppo_agent_node.reporting.pictures.flights import dots
from ppo_agent_node.reporting.pictures.flights import subject
from ppo_agent_node.reporting.pictures.style import BLUE
from ppo_agent_node.reporting.pictures.style import GREEN
from ppo_agent_node.reporting.pictures.style import INK
from ppo_agent_node.reporting.pictures.style import PALE
from ppo_agent_node.reporting.pictures.style import VERMILION
from rocket_sim_node.palette import words
from rocket_sim_node.worlds.base import F64

Figures = Mapping[str, Any]
Limits = Mapping[str, float]


def on_ground(episodes: EpisodeTable) -> NDArray[np.bool_]:
    """Return `(K,)` whether episodes ended on the ground."""
    return ~episodes.named(*IN_FLIGHT)


def touchdown_figure(figures: Figures, episodes: EpisodeTable, limits: Limits) -> Figure:
    """Return histograms of speed, tilt and distance of flights that ended on the ground.

    For a rocket these are at touchdown; other worlds continue until everything is at rest.

    :param limits: settings of the world, of which `landed_speed`, `landed_tilt` and
        `landed_distance` are drawn if present.
    """
    figure = Figure(figsize=(11, 4.2))
    rocket = str(figures['world']).startswith('rocket')
    ground, when = on_ground(episodes), 'touchdown' if rocket else 'the end'
    landed, panels = episodes.named('landed')[ground], figure.subplots(1, 3)
    for axes, column, limit, what, unit in (
        (panels[0], 'touchdown_speed_m_s', 'landed_speed', f'speed at {when}', 'm/s'),
        (panels[1], 'tilt_deg', 'landed_tilt', f'tilt at {when}', 'deg'),
        (panels[2], 'distance_m', 'landed_distance', "distance from the pad's centre", 'm'),
    ):
        _histogram(axes, episodes.numbers[column][ground], landed, limits.get(limit), what, unit)
    panels[0].set_ylabel('touchdowns per bin' if rocket else 'episodes per bin')
    crashes = int((~landed).sum())
    figure.suptitle(
        f'{subject(figures)}: speed, tilt and distance of {len(landed)} '
        + ('touchdowns' if rocket else 'flights that ended on the ground'),
        x=0.01, ha='left')
    handles = [Patch(color=GREEN, label=f'{int(landed.sum())} landed')]
    if crashes:
        handles.append(Patch(color=VERMILION, label=f'{crashes} crashed'))
    figure.legend(handles=handles, loc='outside lower center', ncols=2)
    return figure


def _histogram(
    axes: Axes, values: F64, landed: NDArray[np.bool_], limit: float | None, what: str, unit: str,
) -> None:
    """Draw landed and crashed touchdowns stacked, the 95th percentile, and the limit if near."""
    percentile = float(np.quantile(values, 0.95))
    top = max(float(values.max()), 1e-9)
    near = limit is not None and limit <= 1.5 * top
    parts = [(part, colour) for part, colour in (
        (values[landed], GREEN), (values[~landed], VERMILION)) if part.size]
    edges = np.linspace(0, top, 41)
    axes.hist([part for part, _ in parts], bins=list(edges), stacked=True,
              color=[colour for _, colour in parts])
    if np.histogram(values, edges)[0].max() > 0.5 * values.size:
        axes.set_yscale('log')  # otherwise one bin hides the tail, which has the crashes
        axes.set_ylim(0.7, None)
    axes.axvline(percentile, color=INK, lw=1.2, ls='--')
    if near:
        axes.axvline(limit or 0.0, color=INK, lw=1.2)
    axes.set_xlim(0, None)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.set_xlabel(f'{what} ({unit})')
    bound = '' if limit is None else f'; limit {limit:g}' + (' (solid)' if near else '')
    axes.set_title(f'mean {values.mean():.3g} {unit}\n95 % below {percentile:.3g} (dashed){bound}',
                   fontsize=10, fontweight='normal')


def footprint_figure(
    figures: Figures, episodes: EpisodeTable, radius: float | None,
) -> Figure:
    """Return the positions of touchdowns: the whole pad, and its middle magnified.

    :param radius: m, of the pad; None: unknown.
    """
    ground = on_ground(episodes)
    x, z = episodes.numbers['end_x_m'], episodes.numbers['end_z_m']
    distance = np.hypot(x[ground], z[ground])
    inner = max(1.15 * float(np.quantile(distance, 0.99)), 1e-6)
    far = 1.05 * max(radius or 0.0, float(distance.max()), 1e-6)
    if (np.abs(z[ground]) < 1e-6).all():
        figure = _strip(figures, episodes, radius, inner, far)
    else:
        figure = Figure(figsize=(10.5, 5.6))
        whole, near = figure.subplots(1, 2)
        for axes, reach, size in ((whole, far, 9.0), (near, inner, 5.0)):
            if radius:
                axes.add_patch(Circle((0, 0), radius, facecolor=PALE, edgecolor=INK, lw=1.2))
            dots(axes, x, z, episodes, figures['outcomes'], ground, size)
            axes.plot(0, 0, '+', color=INK, ms=14, mew=1, zorder=1)
            axes.set_aspect('equal')
            axes.set_xlim(-reach, reach)
            axes.set_ylim(reach, -reach)  # z towards the viewer, as seen from above with y up
            axes.xaxis.set_major_locator(MaxNLocator(6))
            axes.yaxis.set_major_locator(MaxNLocator(6))
            axes.set_xlabel('x (m)')
            axes.set_ylabel('z (m)')
        whole.set_title(f'whole pad, radius {radius:g} m' if radius else 'all touchdowns',
                        fontsize=10.5, fontweight='normal')
        near.set_title('centre, with 99 % of touchdowns', fontsize=10.5, fontweight='normal')
        handles, labels = whole.get_legend_handles_labels()
        figure.legend(handles, labels, loc='outside lower center', ncols=len(handles),
                      markerscale=1.5)
    figure.suptitle(
        f'{subject(figures)}: 95 % of {int(ground.sum())} touchdowns within '
        f'{np.quantile(distance, 0.95):.2g} m of the centre\n', x=0.01, ha='left')
    return figure


def _strip(
    figures: Figures, episodes: EpisodeTable, radius: float | None, inner: float, far: float,
) -> Figure:
    """Return the same for flights within a vertical plane, whose touchdowns lie on a line."""
    figure = Figure(figsize=(10.5, 4.6))
    ground, colours = on_ground(episodes), style.outcome_colours(tuple(figures['outcomes']))
    x = episodes.numbers['end_x_m']
    for axes, reach in zip(figure.subplots(1, 2), (far, inner), strict=True):
        parts = {name: x[ground & episodes.named(name)] for name in figures['outcomes']}
        parts = {name: part for name, part in parts.items() if part.size}
        edges = np.linspace(-reach, reach, 61)
        axes.hist(
            list(parts.values()), bins=list(edges), stacked=True,
            color=[colours[name] for name in parts],
            label=[style.plain(words(name)) for name in parts])
        if radius:
            axes.axvspan(-radius, radius, color=PALE, zorder=0)
            for side in (-radius, radius):
                axes.axvline(side, color=INK, lw=1.2)
        axes.axvline(0, color=INK, lw=1, ls=':')
        axes.set_xlim(-reach, reach)
        axes.set_xlabel("x from the pad's centre (m)")
        if np.histogram(x[ground], edges)[0].max() > 0.5 * ground.sum():
            axes.set_yscale('log')
            axes.set_ylim(0.7, None)
    whole, near = figure.axes
    whole.set_ylabel('touchdowns per bin')
    whole.set_title(f'whole pad, {radius:g} m to either side' if radius else 'all touchdowns',
                    fontsize=10.5, fontweight='normal')
    near.set_title('centre, with 99 % of touchdowns', fontsize=10.5, fontweight='normal')
    handles, labels = whole.get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=len(handles))
    return figure


def fuel_figure(figures: Figures, episodes: EpisodeTable) -> Figure:
    """Return fuel against the minimum of a straight drop from the same start."""
    speed, used = episodes.numbers['start_descent_m_s'], episodes.numbers['fuel_used_kg']
    bound = episodes.numbers['fuel_bound_kg']
    ratio = (used / bound)[episodes.named('landed')]
    ratio = ratio[np.isfinite(ratio)]
    figure = Figure(figsize=(10.5, 4.8))
    left, *others = figure.subplots(1, 2, width_ratios=(3, 2)) if ratio.size else (
        figure.subplots(),)
    dots(left, speed, used, episodes, figures['outcomes'], np.isfinite(used))
    order = np.argsort(speed)
    left.plot(speed[order], bound[order], '-', color=INK, lw=2,
              label='minimum for a straight drop')
    if np.ptp(speed) < 1e-6:
        left.plot(speed[:1], bound[:1], '_', color=INK, ms=30, mew=2)
        left.set_xlim(speed[0] - 1, speed[0] + 1)
    left.set_xlabel('downward speed at the start (m/s)')
    left.set_ylabel('fuel used (kg)')
    for right in others:
        right.hist(ratio, bins=40, color=BLUE)
        right.axvline(1.0, color=INK, lw=2)
        right.axvline(ratio.mean(), color=INK, lw=1.2, ls='--')
        right.set_xlabel('fuel used / minimum (no unit)')
        right.set_ylabel('landings per bin')
        right.set_title(f'mean {ratio.mean():.3f} (dashed), median {np.median(ratio):.3f}',
                        fontsize=10, fontweight='normal')
    finding = (
        f'landings use {ratio.mean():.3f} times the minimum fuel' if ratio.size
        else 'fuel of flights, none of which landed')
    figure.suptitle(f'{subject(figures)}: {finding}', x=0.01, ha='left')
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', markerscale=2.5, ncols=5)
    return figure
