# SPDX-License-Identifier: Apache-2.0
"""Formatting of a report's figures as text."""
from __future__ import annotations

import math

from rocket_sim_node.telemetry.training_status import Status

STAGES = {
    'demonstrate': 'expert flies', 'clone': 'cloning', 'finetune': 'PPO', 'evaluate': 'evaluating',
    'land': 'landing', 'done': 'done',
}
_LEVELLED = ('finetune', 'evaluate', 'land')


def stage_name(stage: str) -> str:
    """Return the displayed name of a stage."""
    return STAGES.get(stage, stage)


def duration(seconds: float) -> str:
    """Return minutes and seconds, and hours if there are any; '?' for an invalid time."""
    if not math.isfinite(seconds):
        return '?'
    whole = max(0, int(seconds))
    if whole < 3600:
        return f'{whole // 60}:{whole % 60:02d}'
    return f'{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}'


def rate(value: float, low: float = math.nan, high: float = math.nan) -> str:
    """Return a fraction in per cent, with its interval if known."""
    text = f'{value:.1%}'
    return text if not math.isfinite(low) else f'{text} [{100 * low:.1f}, {100 * high:.1f}]'


def amount(count: int) -> str:
    """Return a large number with three digits."""
    for size, name in ((1e9, ' G'), (1e6, ' M'), (1e3, ' k')):
        if count >= 0.9995 * size:  # rounds to 1.00
            return f'{count / size:.3g}{name}'
    return str(count)


def counted(status: Status) -> tuple[int, int, str]:
    """Return how much of a stage is done, the total (0: unknown), and the unit."""
    if status.goal:
        return status.progress, status.goal, status.unit
    return status.iteration, status.iterations, status.unit


def count_text(status: Status) -> str:
    """Return that as text, '' if nothing is counted; iterations have no unit."""
    done, goal, unit = counted(status)
    if not goal:
        return ''
    return f'{done}/{goal} episodes' if unit == 'episodes' else f'{done}/{goal}'


def figures(status: Status) -> list[str]:
    """Return the figures of an iteration, the most important first."""
    parts = []
    if status.level and status.stage in _LEVELLED:
        parts.append(f'level {status.level}')
    if math.isfinite(status.reach):
        parts.append(f'from up to {status.reach:.3g} m')
    if math.isfinite(status.landing_rate):
        parts.append('landed ' + rate(
            status.landing_rate, status.landing_rate_low, status.landing_rate_high))
    if math.isfinite(status.mean_return):
        parts.append(f'return {status.mean_return:.1f}')
    if math.isfinite(status.clone_validation_loss):
        parts.append(f'validation loss {status.clone_validation_loss:.5f}')
    if math.isfinite(status.steps_per_second):
        parts.append(f'{status.steps_per_second:,.0f} steps/s')
    return parts


def without_noise(status: Status) -> str:
    """Return the latest evaluation without noise as text, '' if there was none."""
    if not math.isfinite(status.selection_return):
        return ''
    landed = rate(
        status.selection_landing_rate, status.selection_landing_rate_low,
        status.selection_landing_rate_high)
    return (f'without noise, at iteration {status.selection_iteration}: landed {landed}, '
            f'return {status.selection_return:.1f}')


def best(status: Status) -> str:
    """Return the best policy so far as text, '' if there is none."""
    if not math.isfinite(status.best_return):
        return ''
    return f'best {status.best_return:.1f} at iteration {status.best_iteration}'


def line(status: Status) -> str:
    """Return a report as one self-contained line."""
    parts = figures(status) if status.is_iteration or status.stage == 'done' else []
    if status.is_iteration:
        if status.stage == 'finetune' and status.selection_iteration == status.iteration:
            parts += filter(None, [without_noise(status)])
        if math.isfinite(status.remaining):
            parts.append(f'{duration(status.remaining)} left')
    text = '; '.join(filter(None, (', '.join(parts), status.message)))
    head = f'{stage_name(status.stage)} {count_text(status)}'.strip()
    return f'[{duration(status.elapsed)}] ' + ': '.join(filter(None, (head, text)))
