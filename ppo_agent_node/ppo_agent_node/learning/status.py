# SPDX-License-Identifier: Apache-2.0
"""What a training run says about itself, one report an iteration of a stage."""
from __future__ import annotations

from dataclasses import dataclass

STAGES = ('demonstrate', 'clone', 'finetune', 'evaluate', 'done')
NAN = float('nan')


@dataclass(frozen=True)
class Status:
    """The fields of `rocket_msgs/msg/TrainingStatus`, where they are described; NaN: not known."""

    run: str = ''
    stage: str = ''
    iteration: int = 0
    iterations: int = 0
    steps: int = 0
    elapsed: float = 0.0
    remaining: float = NAN
    steps_per_second: float = NAN
    level: int = 0
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
    message: str = ''
