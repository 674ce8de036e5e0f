# SPDX-License-Identifier: Apache-2.0
"""Status of a training run, reported for each iteration and each event."""
from __future__ import annotations

import math
from dataclasses import dataclass
from dataclasses import fields
from typing import Any

NAN = float('nan')


@dataclass(frozen=True)
class Status:
    """Fields of `rocket_msgs/msg/TrainingStatus`, documented there; NaN: unknown."""

    run: str = ''
    folder: str = ''
    stages: tuple[str, ...] = ()
    stage: str = ''
    iteration: int = 0
    iterations: int = 0
    progress: int = 0
    goal: int = 0
    unit: str = ''
    steps: int = 0
    elapsed: float = 0.0
    remaining: float = NAN
    steps_per_second: float = NAN
    level: int = 0
    reach: float = NAN
    landing_rate: float = NAN
    landing_rate_low: float = NAN
    landing_rate_high: float = NAN
    episodes: int = 0
    mean_return: float = NAN
    mean_length: float = NAN
    policy_loss: float = NAN
    value_loss: float = NAN
    entropy: float = NAN
    approx_kl: float = NAN
    clipfrac: float = NAN
    explained_variance: float = NAN
    learning_rate: float = NAN
    log_std: float = NAN
    clone_loss: float = NAN
    clone_validation_loss: float = NAN
    selection_iteration: int = 0
    selection_landing_rate: float = NAN
    selection_landing_rate_low: float = NAN
    selection_landing_rate_high: float = NAN
    selection_return: float = NAN
    best_iteration: int = 0
    best_landing_rate: float = NAN
    best_return: float = NAN
    saved: str = ''
    message: str = ''

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
