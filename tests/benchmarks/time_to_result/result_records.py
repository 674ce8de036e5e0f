# SPDX-License-Identifier: Apache-2.0
"""Requirements and records of the runs of `bench result`."""
from __future__ import annotations

import math
from dataclasses import dataclass
from dataclasses import field
from typing import Any


@dataclass(frozen=True)
class Options:
    """Fields that all runs have in common."""

    target: float
    """mean return of 100 deterministic episodes or more that ends a run"""
    cap: float
    """time limit of a run from its start, s"""
    verify: int
    """number of episodes flown in Gymnasium after a run"""
    extra: dict[str, str] = field(default_factory=dict)
    """further parameters of our agent"""


@dataclass
class Point:
    """One evaluation."""

    seconds: float
    """from the start of the processes"""
    steps: int
    """number of training steps so far, in all environments"""
    mean_return: float
    landing_rate: float | None = None


@dataclass
class TimedRun:
    """Record of one run."""

    contestant: str
    seed: int
    passed: bool = False
    seconds: float = 0.0
    """from the start of the processes to the evaluation that passed, or to the time limit"""
    learning_seconds: float | None = None
    """the same from the first step, if known"""
    evaluations: list[Point] = field(default_factory=list)
    gymnasium: dict[str, float] = field(default_factory=dict)
    """flights of the policy that passed in Gymnasium's lander: mean return, deviation, episodes"""
    settings: dict[str, Any] = field(default_factory=dict)
    """settings that are only known from the run"""

    @property
    def steps(self) -> int:
        """Steps of training until the last evaluation."""
        return self.evaluations[-1].steps if self.evaluations else 0

    @property
    def mean_return(self) -> float:
        """Mean return of the last evaluation."""
        return self.evaluations[-1].mean_return if self.evaluations else math.nan
