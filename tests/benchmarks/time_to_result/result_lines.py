# SPDX-License-Identifier: Apache-2.0
"""How a contestant of `bench result` that runs in a process of its own tells how it goes.

One JSON object a line on its standard output. Its clock, `at`, is CLOCK_MONOTONIC, which all
processes of a machine share, so that the starting program can count from the start.
"""
from __future__ import annotations

import json
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

EVALUATION_SEED = 30_000_000
"""of the evaluations that end a run"""
VERIFICATION_SEED = 20_000_000
"""of the flights in Gymnasium that follow"""


class StatusPublisher:
    """Prints what happens in a run."""

    def __init__(self, first_step: float) -> None:
        """Begin with the moment before the first step."""
        _tell(event='first_step', at=first_step)

    def evaluated(self, steps: int, mean_return: float) -> None:
        """Tell of an evaluation, after so many steps of training."""
        _tell(event='evaluation', at=time.monotonic(), steps=steps, mean_return=mean_return)

    def verified(self, returns: NDArray[np.float64]) -> None:
        """Tell of the flights after the run, whose time counts no more."""
        _tell(event='verified', at=time.monotonic(), mean_return=float(returns.mean()),
              deviation=float(returns.std()), episodes=len(returns))


def _tell(**facts: Any) -> None:
    print(json.dumps(facts), flush=True)
