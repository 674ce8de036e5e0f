# SPDX-License-Identifier: Apache-2.0
"""Catalogue of a run's pictures, in order, with captions."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ppo_agent_node.reporting.pictures import conditions
from ppo_agent_node.reporting.pictures import flights
from ppo_agent_node.reporting.pictures import initial_conditions
from ppo_agent_node.reporting.pictures import optimum
from ppo_agent_node.reporting.pictures import style
from ppo_agent_node.reporting.pictures import touchdowns
from ppo_agent_node.reporting.pictures import training_curves
from ppo_agent_node.reporting.run_files import Run

EVALUATION, CONDITIONS, TRAINING = 'Evaluation', 'Conditions', 'Training'
_PAD_OF_LANDER = 0.2
"""Half-width of the pad relative to the field, as in Gymnasium's LunarLander."""


@dataclass(frozen=True)
class Picture:
    """A drawn picture."""

    path: Path
    title: str
    caption: str
    section: str


@dataclass(frozen=True)
class _Entry:
    title: str
    section: str
    draw: Callable[[Run], Figure | None]
    caption: str


def draw(run: Run, folder: Path) -> list[Picture]:
    """Draw all pictures that a run's files allow, and return them in order.

    Pictures of an earlier evaluation that the present one does not have are removed.

    :raises OSError: when one cannot be written.
    :raises ValueError: when a line of the log has text instead of a number.
    """
    folder.mkdir(parents=True, exist_ok=True)
    drawn = []
    for name, entry in CATALOGUE.items():
        path = folder / f'{name}.png'
        with style.styled():
            figure = entry.draw(run)
            if figure is not None:
                style.save(figure, path)
                drawn.append(Picture(path, entry.title, entry.caption, entry.section))
            elif entry.section == EVALUATION and run.episodes is not None:
                path.unlink(missing_ok=True)
    return drawn


def _outcomes(run: Run) -> Figure | None:
    return flights.outcomes_figure(run.figures) if run.figures else None


def _returns(run: Run) -> Figure | None:
    if run.figures is None or run.episodes is None:
        return None
    return flights.returns_figure(run.figures, run.episodes)


def _touchdown(run: Run) -> Figure | None:
    if (run.figures is None or run.episodes is None
            or not touchdowns.on_ground(run.episodes).any()):
        return None
    return touchdowns.touchdown_figure(run.figures, run.episodes, run.world_settings)


def _footprint(run: Run) -> Figure | None:
    if run.figures is None or run.episodes is None:
        return None
    ground = touchdowns.on_ground(run.episodes)
    where = [run.episodes.numbers[name][ground] for name in ('end_x_m', 'end_z_m')]
    if not ground.any() or not np.isfinite(where).all():
        return None
    settings = run.world_settings
    radius = settings.get('landed_distance')
    if radius is None and 'field_half_width' in settings:
        radius = _PAD_OF_LANDER * settings['field_half_width']
    return touchdowns.footprint_figure(run.figures, run.episodes, radius)


def _fuel(run: Run) -> Figure | None:
    if (run.figures is None or run.episodes is None
            or not np.isfinite(run.episodes.numbers['fuel_bound_kg']).any()):
        return None
    return touchdowns.fuel_figure(run.figures, run.episodes)


def _optimum(run: Run) -> Figure | None:
    if run.figures is None or run.episodes is None:
        return None
    return optimum.optimum_figure(run.figures, run.episodes)


def _starts(run: Run) -> Figure | None:
    if run.figures is None or run.episodes is None:
        return None
    return initial_conditions.conditions_figure(run.figures, run.episodes)


def _conditions(run: Run) -> Figure | None:
    return conditions.heat_maps(run.conditions) if run.conditions else None


def _cloning(run: Run) -> Figure | None:
    lines = run.stage('clone')
    return training_curves.cloning_figure(lines) if lines else None


def _training(run: Run) -> Figure | None:
    lines = run.stage('finetune')
    return training_curves.training_figure(lines) if len(lines) > 1 else None


def _diagnostics(run: Run) -> Figure | None:
    lines = run.stage('finetune')[1:]  # the first is the evaluation before any update
    return training_curves.diagnostics_figure(lines) if lines else None


def _scores(run: Run) -> Figure | None:
    scores = [score for line in run.stage('finetune') for score in line.get('scores') or ()]
    return training_curves.score_figure(np.array(scores, np.float64)) if scores else None


CATALOGUE = {
    'outcomes': _Entry('How the episodes ended', EVALUATION, _outcomes, (
        'All episodes by outcome, as a pie and as bars with counts. Green means landed; every '
        'other colour is a kind of failure.')),
    'returns': _Entry('Reward per episode', EVALUATION, _returns, (
        'Each dot is the return of one episode, in the colour of its outcome; the histogram on '
        'the right counts them. Landings form a thin line at the top; crashes lie far below.')),
    'touchdown': _Entry('Speed, tilt and distance at touchdown', EVALUATION, _touchdown, (
        'Speed, tilt and distance from the centre at touchdown. Further left is better; 95 % of '
        'the touchdowns lie to the left of the dashed line.')),
    'footprint': _Entry('Touchdown points', EVALUATION, _footprint, (
        'Touchdown points seen from above (from the side if all flights lie in one plane), on '
        'the whole pad and magnified. Dots away from the cross show a bias; widely spread dots '
        'show scatter.')),
    'optimum': _Entry('Fuel and time compared with the optimum', EVALUATION, _optimum, (
        'Landings from starts whose optimum was computed, sorted. A bar shows the fuel, or the '
        'time, used beyond the minimum for a soft landing from the same start with a thrust '
        'vector that can turn instantly.')),
    'fuel': _Entry('Fuel compared with a straight drop', EVALUATION, _fuel, (
        'Fuel of each episode over its speed at the start. The line is the minimum for a straight '
        'drop to rest. Fuel beyond it (on the right: the ratio) was wasted, or was needed to '
        'correct tilt, drift and offset.')),
    'initial_conditions': _Entry('Landing rate by initial condition', EVALUATION, _starts, (
        'Episodes in bins of equal count along each initial condition. Where an interval lies '
        'below the grey band, the policy is weaker there than its average.')),
    'conditions': _Entry('Landing rate and return by condition', CONDITIONS, _conditions, (
        'One row per condition, one column per pilot, all from the same starts: the landing rate '
        'and the mean return, failures included. The return is also low if rockets land late, '
        'hard or off the centre.')),
    'training': _Entry('Learning curves', TRAINING, _training, (
        'Mean return (raw and smoothed), landing rate with its 95 % interval, and level, by '
        'iteration. The red dots are flights without noise on the final level, which select the '
        'best policy.')),
    'cloning': _Entry('Cloning the expert', TRAINING, _cloning, (
        'Imitation loss on the demonstrations (blue) and on held-out episodes (red), by epoch. '
        'If red rises while blue falls, the policy overfits. The star marks the policy that was '
        'kept.')),
    'diagnostics': _Entry('Losses, entropy and divergence', TRAINING, _diagnostics, (
        'Diagnostics of each update. The divergence (KL) should stay near its target or below, '
        'entropy should fall slowly, and explained variance should rise towards 1 if returns '
        'differ.')),
    'score': _Entry('Score of each episode', TRAINING, _scores, (
        'The score of each training episode, in the order in which they ended, and the average '
        'of the last 50.')),
}
