# SPDX-License-Identifier: Apache-2.0
"""Status lines by which a contestant of `bench result` reports from a separate process.

Each line on standard output is a JSON object. Its time, `at`, is CLOCK_MONOTONIC, which all
processes of a machine share, so the parent process can compute the time since the start.
"""
from __future__ import annotations

import json
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

EVALUATION_SEED = 30_000_000
"""seed of the evaluations that can end a run"""
VERIFICATION_SEED = 20_000_000
"""seed of the subsequent flights in Gymnasium"""


class StatusPublisher:
    """Prints the status lines of a run."""

    def __init__(self, first_step: float) -> None:
        """Print the time of the first step."""
        _tell(event='first_step', at=first_step)

    def evaluated(self, steps: int, mean_return: float) -> None:
        """Print an evaluation after `steps` steps of training."""
        _tell(event='evaluation', at=time.monotonic(), steps=steps, mean_return=mean_return)

    def verified(self, returns: NDArray[np.float64]) -> None:
        """Print the untimed flights after the run."""
        _tell(event='verified', at=time.monotonic(), mean_return=float(returns.mean()),
              deviation=float(returns.std()), episodes=len(returns))


def _tell(**facts: Any) -> None:
    print(json.dumps(facts), flush=True)
