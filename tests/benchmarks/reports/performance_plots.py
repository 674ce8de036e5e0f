# SPDX-License-Identifier: Apache-2.0
"""A plot for each table of docs/results/performance.md."""
from __future__ import annotations

import statistics
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.reports.performance_text import Figures
from benchmarks.reports.performance_text import batch
from ppo_agent_node.reporting.pictures.style import CYCLE
from ppo_agent_node.reporting.pictures.style import GREY
from ppo_agent_node.reporting.pictures.style import plain_logarithm
from ppo_agent_node.reporting.pictures.style import save
from ppo_agent_node.reporting.pictures.style import styled


def _curves(axes: Axes, curves: dict[str, dict[str, float]], x: str, y: str) -> None:
    """Draw curves over batch sizes, both axes logarithmic."""
    for (name, values), colour in zip(curves.items(), CYCLE, strict=False):
        sizes = [int(size) for size in values]
        axes.plot(sizes, list(values.values()), 'o-', color=colour, label=name)
    axes.set(xscale='log', yscale='log', xlabel=x, ylabel=y)
    ticks = sorted({int(size) for values in curves.values() for size in values})
    axes.set_xticks(ticks, [f'{tick:,}' for tick in ticks], minor=False)
    axes.minorticks_off()
    plain_logarithm(axes.yaxis)
    # Below the axes, where it hides no curve.
    axes.legend(loc='upper center', bbox_to_anchor=(0.5, -0.14), ncols=4)


def _bars(axes: Axes, groups: list[str], series: dict[str, list[float]], y: str) -> None:
    """Draw groups of bars."""
    width = 0.8 / len(series)
    for number, ((name, values), colour) in enumerate(zip(series.items(), CYCLE, strict=False)):
        place = np.arange(len(groups)) + (number - (len(series) - 1) / 2) * width
        axes.bar(place, values, 0.92 * width, color=colour, label=name)
    axes.set_xticks(np.arange(len(groups)), groups)
    axes.set(ylabel=y)
    axes.grid(visible=False, axis='x')
    if len(series) > 1:
        axes.legend()


def _exchange(axes: Axes, f: Figures) -> None:
    rows = f['exchange']
    names = {
        'dds': 'DDS, as scheduled', 'dds_apart': 'DDS, a core each',
        'tcp_apart': 'TCP, a core each', 'tcp': 'TCP, as scheduled'}
    _curves(axes, {
        label: {size: row[key] for size, row in rows.items()} for key, label in names.items()},
        'rockets', 'one exchange, us (median)')


def _budget(axes: Axes, f: Figures) -> None:
    rows = f['budget']
    names, values = [row['what'] for row in rows], [row['us'] for row in rows]
    colours = [{'agent': CYCLE[0], 'simulator': CYCLE[1]}.get(row['who'], GREY) for row in rows]
    axes.barh(np.arange(len(rows))[::-1], values, color=colours)
    axes.set_yticks(np.arange(len(rows))[::-1], names)
    axes.set(xlabel='us of a step (median); blue: agent, vermilion: simulator')
    axes.grid(visible=False, axis='y')


def _rollouts(axes: Axes, f: Figures) -> None:
    rows = f['rollouts']
    names = {
        'in process, 1': 'one process, no ROS', 'DDS, 1': 'DDS, one simulator',
        'DDS, 2': 'DDS, two simulators'}
    _bars(axes, list(rows), {
        label: [row['steps_per_second'][key] / 1e3 for row in rows.values()]
        for key, label in names.items()}, '1 000 rocket steps/s')
    axes.set(xlabel='rockets')


def _fleet(axes: Axes, f: Figures) -> None:
    rows = f['fleet']
    _bars(axes, list(rows), {'': [row['cpu_us'] for row in rows.values()]},
          "agent's processor time for an exchange, us")
    axes.set(xlabel='simulators')


def _hosts(axes: Axes, f: Figures) -> None:
    rows = f['hosts']
    _bars(axes, list(rows), {
        'within a host': [row['within_median'] for row in rows.values()],
        'between two': [row['between_median'] for row in rows.values()]},
        'one exchange, us (median)')
    axes.set(xlabel='rockets')


def _ranks(axes: Axes, f: Figures) -> None:
    f = f['ranks']
    for (name, one), colour in zip(f['model'].items(), CYCLE, strict=False):
        axes.plot(f['counts'], one['shares'], 'o-' if name.endswith('ring') else 's--',
                  color=colour, label=name.replace('two ranks, ', 'a delay of ', 1)
                  if ' ms' in name else name.replace('two ranks', 'one machine'))
    axes.axhline(0.5, color='black', linewidth=0.8)
    axes.set(xscale='log', xlabel='ranks', ylabel='share of the time at work (model)',
             ylim=(0.0, 1.0))
    axes.set_xticks(f['counts'], [f'{count:,}' for count in f['counts']])
    axes.minorticks_off()
    axes.legend()


def _stepping(axes: Axes, f: Figures) -> None:
    _curves(axes, f['steps_per_second'], 'environments in a batch', 'steps/s on one core')


def _threads(axes: Axes, f: Figures) -> None:
    rows = f['threads']
    _bars(axes, [f'{row["world"]},\n{row["size"]}' for row in rows], {
        '': [row['gain'] for row in rows]},
        f'speed of {rows[0]["threads"]} threads, one thread = 1')
    axes.axhline(1.0, color='black', linewidth=0.8)
    axes.tick_params(axis='x', labelsize=8)


def _learner(axes: Axes, f: Figures) -> None:
    rows = f['learner']
    names = [f'{row["case"]["world"]}, {row["case"]["batch_size"]},\n{row["threads"]} thread'
             + ('s' if row['threads'] > 1 else '') for row in rows]
    _bars(axes, names, {
        'ours': [row['samples_per_second']['ours'] / row['floor'] for row in rows],
        'stable-baselines3': [row.get('SB3', np.nan) / row['floor'] for row in rows]},
        'share of what the bare products make')
    axes.tick_params(axis='x', labelsize=8)


def _recorder(axes: Axes, f: Figures) -> None:
    labels = [name.replace('_recorder', '_\nrecorder').replace('_viewed', ', viewed')
              .replace(', ', ',\n') for name in f]
    _bars(axes, labels, {
        'without the node': [part['without'] / 1e3 for part in f.values()],
        'with it': [part['with'] / 1e3 for part in f.values()]}, '1 000 rocket steps/s')
    axes.tick_params(axis='x', labelsize=8)


def _loss(axes: Axes, f: Figures) -> None:
    rows = f['loss']
    _bars(axes, [f'{float(share):.0%}' for share in rows], {
        label: [row[key] for row in rows.values()]
        for key, label in {'p50': 'median', 'p99': '99th percentile', 'p999': '99.9th'}.items()},
        'a step, ms')
    axes.set(xlabel='packets lost')


def _heuristic(axes: Axes, f: Figures) -> None:
    rows = f['heuristic']
    _bars(axes, [row['action'] for row in rows], {
        'ours': [row['ours']['mean'] for row in rows],
        'Gymnasium': [row['theirs']['mean'] for row in rows]}, 'mean return')
    axes.set(xlabel='actions')


def _transfer(axes: Axes, f: Figures) -> None:
    _bars(axes, ['our lunar_lander', "Gymnasium's"], {'': [f['ours'], f['gymnasium']]},
          'mean return')


def _stopping(axes: Axes, f: Figures) -> None:
    _bars(axes, list(f), {
        'median': [statistics.median(seconds) for seconds in f.values()],
        'longest': [max(seconds) for seconds in f.values()]}, 's from Ctrl-C to the last end')
    axes.set(xlabel='interrupted in')


def _key_latency(axes: Axes, f: Figures) -> None:
    axes.hist(f['latencies_ms'], bins=30, color=CYCLE[0])
    axes.set(xlabel='from key to state, ms', ylabel='presses')


PLOTS: dict[str, Callable[[Axes, Figures], None]] = {
    'exchange': _exchange, 'budget': _budget, 'rollouts': _rollouts, 'fleet': _fleet,
    'hosts': _hosts, 'ranks': _ranks, 'learner': _learner, 'stepping': _stepping,
    'threads': _threads, 'recorder': _recorder,
    'loss': _loss, 'heuristic': _heuristic, 'transfer': _transfer, 'stopping': _stopping,
    'key_latency': _key_latency}


def _exchange_finding(f: Figures) -> str:
    size, row = batch(f['exchange'])
    return (f'With a core each, an exchange of {size} rockets over DDS takes '
            f'{row["ratio_apart"]:.1f} times\nas long as a TCP ping-pong of the same bytes')


def _budget_finding(f: Figures) -> str:
    parts = [row for row in f['budget'] if row['who'] in ('agent', 'simulator', 'between')]
    whole = sum(row['us'] for row in parts)
    inference = sum(row['us'] for row in parts if row['what'].startswith('inference'))
    between = sum(row['us'] for row in parts if row['who'] == 'between')
    return (f'Inference takes {inference / whole:.0%} of a step of {f["num_envs"]} rockets,\n'
            f'DDS and the kernel {between / whole:.0%}')


def _rollouts_finding(f: Figures) -> str:
    rows = f['rollouts']
    shares = ', '.join(f'{row["ratio"]["DDS, 2"]:.0%} with {int(size):,}'
                       for size, row in rows.items())
    return f'Two simulators over DDS reach this share of the speed\nof one process: {shares}'


def _fleet_finding(f: Figures) -> str:
    last, row = list(f['fleet'].items())[-1]
    return (f'With {last} simulators, an exchange costs the agent\n'
            f'{row["ratio"]:.2f} times as much as with one')


def _hosts_finding(f: Figures) -> str:
    size, row = batch(f['hosts'])
    return (f'An exchange of {size} rockets with another host takes {row["ratio"]:.1f} times\n'
            'as long as one within the host')


def _ranks_finding(f: Figures) -> str:
    model = f['ranks']['model']
    ring, tree = (model[f'two ranks, {way}']['knee'] for way in ('ring', 'tree'))
    slow = model['two ranks, 1 ms, ring']['knee'] if 'two ranks, 1 ms, ring' in model else None
    return (f'Ranks wait longer than they work from {ring} on (ring) or {tree} (tree)'
            + (f',\nand from {slow} on over a network with a delay of 1 ms' if slow else ''))


def _stepping_finding(f: Figures) -> str:
    lander = f['ratios']['lunar_lander']
    peer = 'EnvPool' if 'EnvPool' in lander else 'Gymnasium'
    return f'lunar_lander makes {lander[peer]:.1f} times as many steps as that of {peer}'


def _threads_finding(f: Figures) -> str:
    best = max(f['threads'], key=lambda row: float(row['gain']))
    return (f'{best["threads"]} threads are up to {best["gain"]:.2f} times as fast as one: '
            f'{best["size"]} of {best["world"]}')


def _learner_finding(f: Figures) -> str:
    gains = [row['ratio'] for row in f['learner'] if 'ratio' in row]
    if not gains:
        return 'Updates reach this share of the bare products'
    return f'An update is {min(gains):.1f} to {max(gains):.1f} times as fast as stable-baselines3'


def _recorder_finding(f: Figures) -> str:
    shares = [part['ratio'] for part in f.values()]
    least, most = f'{min(shares):.0%}', f'{max(shares):.0%}'
    reached = least if least == most else f'{least} to {most}'
    return f'Beside a node that listens, training and flying run\nat {reached} of their speed'


def _loss_finding(f: Figures) -> str:
    rows = ', '.join(f'{row["p99"]:.1f} ms with {float(share):.0%}'
                     for share, row in f['loss'].items())
    return f'99 % of the steps take less than\n{rows} of the packets lost'


def _heuristic_finding(f: Figures) -> str:
    return "The scripted pilot's return differs by\n" + ' and '.join(
        f'{row["difference"]:+.0f} {_interval(row, 0)} ({row["action"]})'
        for row in f['heuristic'])


def _transfer_finding(f: Figures) -> str:
    return (f'The policy returns {f["ours"]:.0f} in our lander and {f["gymnasium"]:.0f} '
            f"in Gymnasium's:\na difference of {f['difference']:+.1f} {_interval(f, 1)}")


def _interval(figures: Figures, digits: int) -> str:
    low, high = figures['difference_interval']
    return f'[{low:+.{digits}f}, {high:+.{digits}f}]'


def _stopping_finding(f: Figures) -> str:
    longest = max(second for seconds in f.values() for second in seconds)
    return f'All processes end within {longest:.1f} s of Ctrl-C'


def _key_latency_finding(f: Figures) -> str:
    return f'Half of the keys show in the state within {f["median_ms"]:.0f} ms'


FINDINGS: dict[str, Callable[[Figures], str]] = {
    'exchange': _exchange_finding, 'budget': _budget_finding, 'rollouts': _rollouts_finding,
    'fleet': _fleet_finding, 'hosts': _hosts_finding, 'ranks': _ranks_finding,
    'stepping': _stepping_finding, 'threads': _threads_finding, 'learner': _learner_finding,
    'recorder': _recorder_finding, 'loss': _loss_finding, 'heuristic': _heuristic_finding,
    'transfer': _transfer_finding, 'stopping': _stopping_finding,
    'key_latency': _key_latency_finding}
"""Titles, by part: each states the finding."""


def draw(part: str, figures: Figures, path: Path) -> bool:
    """Draw the plot of a part; return whether the part has one."""
    plot = PLOTS.get(part)
    if plot is None:
        return False
    with styled():
        figure = Figure(figsize=(8.0, 4.2))
        axes = figure.add_subplot()
        plot(axes, figures)
        axes.set_title(FINDINGS[part](figures))
        save(figure, path)
    return True
