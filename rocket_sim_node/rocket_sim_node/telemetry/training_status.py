# SPDX-License-Identifier: Apache-2.0
"""Status of a training run, reported for each iteration and each event.

The fields of :class:`Status` are the table from which TrainingStatus.msg and the curves of
recordings follow. A new value is one row there; the trainer sets it by name.
"""
from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
from dataclasses import fields
from dataclasses import replace
from typing import Any

from rocket_sim_node import palette
from rocket_sim_node.palette import Colour

PLOTS = {
    'return': 'Return', 'landing_rate': 'Landing rate (%)', 'loss': 'Losses',
    'cloning': 'Cloning loss', 'divergence': 'KL divergence and clipping',
    'entropy': 'Entropy (nats)', 'speed': 'Steps per second', 'level': 'Curriculum level',
    'reach': 'Height of the highest starts (m)',
}
"""Titles of the plots of a training, by their entity below `/training`."""


@dataclass(frozen=True)
class Curve:
    """One line of a plot of :data:`PLOTS`: the value of Status, which is set here, times `factor`.

    Lines that are not `front` are drawn first.
    """

    plot: str
    name: str
    colour: Colour
    factor: float = 1.0
    front: bool = False
    value: str = ''


def _told(default: Any, kind: str, meaning: str, curve: Curve | None = None) -> Any:
    return field(default=default, metadata={'kind': kind, 'meaning': meaning, 'curve': curve})


def _text(meaning: str) -> Any:
    return _told('', 'string', meaning)


def _count(meaning: str, kind: str = 'uint32', curve: Curve | None = None) -> Any:
    return _told(0, kind, meaning, curve)


def _number(meaning: str = '', curve: Curve | None = None, default: float = math.nan) -> Any:
    return _told(default, 'float64', meaning, curve)


@dataclass(frozen=True)
class Status:
    """Status of a run; NaN: unknown. Each field has the comment of its field in the message."""

    run: str = _text('name of the run')
    folder: str = _text('folder of the run, as given to the agent')
    stages: tuple[str, ...] = _told(
        (), 'string[]', 'of this run, in order: demonstrate, clone, finetune, evaluate')
    stage: str = _text('one of them, or done')
    iteration: int = _count(
        'within the stage, from 1; in finetune: 0 before the first update; in evaluate: episodes '
        'flown')
    iterations: int = _count('maximum number planned for the stage')
    progress: int = _count('progress towards the end of the stage', 'uint64')
    goal: int = _count('progress at the end of the stage, 0 if unknown', 'uint64')
    unit: str = _text('of both: waves, epochs, iterations, episodes')
    steps: int = _count('rocket steps taken by the run so far', 'uint64')
    elapsed: float = _number('s of wall clock in this process', default=0.0)
    remaining: float = _number('s, estimated for the stage; inf before there is an estimate')
    steps_per_second: float = _number(
        'rocket steps per second of wall clock, over this iteration',
        Curve('speed', 'rocket steps per second', palette.SKY))
    level: int = _count(
        'curriculum level, 0 without a curriculum', 'int32',
        Curve('level', 'level', palette.ORANGE))
    reach: float = _number(
        'm above touchdown, highest start of the reverse curriculum',
        Curve('reach', 'above touchdown', palette.ORANGE))
    landing_rate: float = _number(
        '0 to 1, over the episodes of this iteration, with exploration noise',
        Curve('landing_rate', 'landing rate', palette.GREEN, 100.0, front=True))
    landing_rate_low: float = _number(
        '0 to 1, lower end of the 95 % Wilson interval',
        Curve('landing_rate', '95 % interval, low', palette.GREY, 100.0))
    landing_rate_high: float = _number(
        '0 to 1, upper end', Curve('landing_rate', '95 % interval, high', palette.GREY, 100.0))
    episodes: int = _count('finished in this iteration')
    mean_return: float = _number(
        'undiscounted, over these episodes', Curve('return', 'mean return', palette.GREEN))
    mean_length: float = _number('steps, over these episodes')
    policy_loss: float = _number(
        "PPO's clipped objective, negated", Curve('loss', 'policy', palette.SKY))
    value_loss: float = _number(
        'loss of the value function', Curve('loss', 'value', palette.ORANGE))
    entropy: float = _number('nats, of the policy', Curve('entropy', 'entropy', palette.SKY))
    approx_kl: float = _number(
        'nats, divergence of the updated policy from the one that flew',
        Curve('divergence', 'approx. KL', palette.PURPLE))
    clipfrac: float = _number(
        '0 to 1, part of the ratios that were clipped',
        Curve('divergence', 'clipped fraction', palette.GREY))
    explained_variance: float = _number('1 at most, of the returns by the value function')
    learning_rate: float = _number('of the optimiser')
    log_std: float = _number(
        "of the exploration, natural logarithm, mean over the action's entries",
        Curve('entropy', 'log std', palette.GREY))
    clone_loss: float = _number(
        'of cloning, on the flights learnt from', Curve('cloning', 'training', palette.SKY))
    clone_validation_loss: float = _number(
        'of cloning, on held-out flights', Curve('cloning', 'held-out flights', palette.ORANGE))
    selection_iteration: int = _count(
        'iteration of the last evaluation without noise, at the final level')
    selection_landing_rate: float = _number('0 to 1, of that evaluation')
    selection_landing_rate_low: float = _number(
        '0 to 1, lower end of the 95 % Wilson interval')
    selection_landing_rate_high: float = _number('0 to 1, upper end')
    selection_return: float = _number('mean return of that evaluation')
    best_iteration: int = _count(
        'iteration of the evaluation with the highest mean return so far')
    best_landing_rate: float = _number('0 to 1, of that evaluation')
    best_return: float = _number('mean return of that evaluation')
    saved: str = _text('files saved last, relative to `folder`')
    message: str = _text("event, e.g. 'level 3 -> 4', 'saved policy.safetensors'")

    def of_run(self) -> dict[str, Any]:
        """Return the fields that stay valid after the run's learning is over."""
        return {
            field.name: getattr(self, field.name) for field in fields(self)
            if field.name in ('run', 'folder', 'stages', 'steps')
            or field.name.startswith(('selection_', 'best_'))}

    @property
    def is_iteration(self) -> bool:
        """Whether it reports an iteration, not only an event."""
        return not math.isnan(self.remaining)


def _curves() -> dict[str, tuple[Curve, ...]]:
    curves = sorted(
        (replace(one.metadata['curve'], value=one.name) for one in fields(Status)
         if one.metadata['curve'] is not None), key=lambda curve: curve.front)
    return {plot: tuple(one for one in curves if one.plot == plot) for plot in PLOTS}


CURVES: Mapping[str, tuple[Curve, ...]] = _curves()
"""Lines of the plots, by entity."""
