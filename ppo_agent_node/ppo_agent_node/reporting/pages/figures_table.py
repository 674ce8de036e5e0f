# SPDX-License-Identifier: Apache-2.0
"""Table of an evaluation's figures for a report: value, interval, spread."""
from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ppo_agent_node.evaluation.episode_table import EpisodeTable
from ppo_agent_node.reporting.pictures.touchdowns import on_ground
from ppo_agent_node.statistics import mean_interval
from rocket_sim_node.palette import words

Row = tuple[str, str, str, str]
HEAD = ('figure', 'value', '95 % interval', 'spread')
_SPREADS = (
    ('touchdown_speed', 'touchdown speed', 'touchdown_speed_m_s', 'm/s'),
    ('tilt', 'tilt at touchdown', 'tilt_deg', 'deg'),
    ('distance', "distance from the pad's centre", 'distance_m', 'm'),
    ('fuel_used_kg', 'fuel used', 'fuel_used_kg', 'kg'),
)
_QUALITY = (
    ('hover_time', 'time spent hovering', 's'),
    ('ignitions', 'ignitions', ''),
    ('control_effort', 'control effort', 'a step'),
)


def rows(figures: Mapping[str, Any], episodes: EpisodeTable | None) -> list[Row]:
    """Return the rows of the table; rows that do not apply to the world are omitted."""
    found: list[Row] = [(
        'landed', f'{figures["landed"]} of {figures["episodes"]}, '
        f'{rate(figures["landing_rate"])}', interval_of_rate(figures, 'landing_rate'), '')]
    if figures.get('standing_rate') is not None:
        ends = ', '.join(f'{words(name)} {count}' for name, count in (
            figures.get('settling') or {}).items() if count)
        found.append(('standing in the end', rate(figures['standing_rate']),
                      interval_of_rate(figures, 'standing_rate'),
                      f'after touchdown: {ends}' if ends else ''))
    low, high = figures['mean_return_interval']
    deviation = figures.get('return_std')
    found.append((
        'mean return', f'{figures["mean_return"]:.2f}', f'{low:.2f} to {high:.2f}',
        '; '.join(filter(None, (
            '' if deviation is None else f'standard deviation {deviation:.4g}',
            '' if figures.get('return_p05') is None else
            f'5 % below {figures["return_p05"]:.2f}')))))
    found += _returns_by_rate(figures) + _flying_quality(figures)
    at_rest = not str(figures['world']).startswith('rocket')
    for name, what, column, unit in _SPREADS:
        spread = figures.get(name) or {}
        if spread.get('mean') is not None:
            label = what.replace('touchdown speed', 'speed at the end').replace(
                'at touchdown', 'at the end') if at_rest else what
            found.append((
                f'{label}, mean', f'{spread["mean"]:.4g} {unit}',
                _interval(episodes, name, column, unit),
                '' if spread.get('p95') is None else f'95 % below {spread["p95"]:.4g} {unit}'))
    found += _fuel_rows(figures, episodes)
    if figures.get('mean_length') is not None:
        found.append(('length, mean', f'{figures["mean_length"]:.1f} steps', '', ''))
    return found


def _fuel_rows(figures: Mapping[str, Any], episodes: EpisodeTable | None) -> list[Row]:
    """Return the comparison with the optimum, or else with a straight drop."""
    found: list[Row] = []
    solved = f'of {figures.get("optimum_sample")} starts'
    if figures.get('fuel_ratio_optimum') is not None:
        least = figures.get('fuel_optimum_kg')
        found.append((
            'fuel used / optimum, mean', f'{figures["fuel_ratio_optimum"]:.4f}',
            _ratio_interval(episodes, 'optimum_fuel_kg'),
            '' if least is None else f'optimum {least:.1f} kg, mean {solved}'))
    elif figures.get('fuel_ratio') is not None:
        least, why = figures.get('fuel_bound_kg'), figures.get('optimum_reason')
        found.append((
            'fuel used / least of a straight drop, mean', f'{figures["fuel_ratio"]:.4f}',
            _ratio_interval(episodes, 'fuel_bound_kg'), ', '.join((
                *([] if least is None else [f'least {least:.1f} kg, mean']),
                *([f'no optimum: {why}'] if why else [])))))
    if figures.get('return_ceiling') is not None:
        time = figures.get('time_optimum_s')
        found.append((
            'ceiling of the return, mean', f'{figures["return_ceiling"]:.2f}', '',
            '' if time is None else f'optimum {time:.2f} s, mean {solved}'))
    return found


def _returns_by_rate(figures: Mapping[str, Any]) -> list[Row]:
    """Return the mean returns of the episodes counted by each rate, unless it counts all."""
    counted = (
        ('landing_rate', 'mean_return_landed', 'landed'),
        ('standing_rate', 'mean_return_standing', 'standing'),
        ('tanks_dry', 'mean_return_tanks_dry', 'with dry tanks'))
    return [
        (f'mean return, {which}', f'{figures[name]:.2f}', '', '')
        for part, name, which in counted
        if figures.get(name) is not None and figures.get(part) not in (None, 1.0)]


def _flying_quality(figures: Mapping[str, Any]) -> list[Row]:
    """Return the rows on flying quality."""
    found: list[Row] = []
    if figures.get('tanks_dry') is not None:
        found.append(('ended with dry tanks', rate(figures['tanks_dry']),
                      interval_of_rate(figures, 'tanks_dry'), ''))
    for name, label, unit in _QUALITY:
        spread = figures.get(name) or {}
        if spread.get('mean') is not None:
            found.append((
                f'{label}, mean', f'{spread["mean"]:.4g} {unit}'.strip(), '',
                '' if spread.get('p95') is None else
                f'95 % at most {spread["p95"]:.4g} {unit}'.strip()))
    return found


def rate(value: float) -> str:
    """Return a rate as text."""
    return f'{100 * value:.2f} %'


def interval_of_rate(figures: Mapping[str, Any], name: str) -> str:
    """Return the interval of a rate as text, '' if there is none."""
    low, high = (100 * bound for bound in figures.get(f'{name}_interval') or (np.nan, np.nan))
    return '' if np.isnan(low) else f'{low:.2f} to {high:.2f} %'


def _interval(episodes: EpisodeTable | None, name: str, column: str, unit: str) -> str:
    """Return the interval of a mean over touchdowns (fuel: over all), '' without episodes."""
    if episodes is None:
        return ''
    values = episodes.numbers[column]
    values = values if name == 'fuel_used_kg' else values[on_ground(episodes)]
    values = values[np.isfinite(values)]
    if not values.size:
        return ''
    low, high = mean_interval(values)
    return f'{low:.4g} to {high:.4g} {unit}'


def _ratio_interval(episodes: EpisodeTable | None, column: str) -> str:
    """Return the interval of the mean fuel ratio over landings, '' without episodes.

    :param column: the reference for the fuel used.
    """
    if episodes is None or column not in episodes.numbers:
        return ''
    ratio = episodes.numbers['fuel_used_kg'] / episodes.numbers[column]
    ratio = ratio[episodes.named('landed') & np.isfinite(ratio)]
    if not ratio.size:
        return ''
    low, high = mean_interval(ratio)
    return f'{low:.4f} to {high:.4f}'


def duration(seconds: float) -> str:
    """Return a duration as text: the two largest units."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return (f'{hours} h {minutes} min' if hours else
            f'{minutes} min {rest} s' if minutes else f'{rest} s')
