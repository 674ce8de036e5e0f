# SPDX-License-Identifier: Apache-2.0
"""The requirements of `bench result` on a run, and its records."""
from __future__ import annotations

import math
from dataclasses import dataclass
from dataclasses import field
from typing import Any


@dataclass(frozen=True)
class Options:
    """Fields that all runs have in common."""

    target: float
    """mean return of 100 deterministic episodes that ends a run"""
    cap: float
    """s from the start after which a run has not reached it"""
    verify: int
    """episodes flown in Gymnasium afterwards"""
    extra: dict[str, str] = field(default_factory=dict)
    """further parameters of our agent"""


@dataclass
class Point:
    """One evaluation."""

    seconds: float
    """from the start of the processes"""
    steps: int
    """of training so far, all environments together"""
    mean_return: float
    landing_rate: float | None = None


@dataclass
class TimedRun:
    """How one run went."""

    contestant: str
    seed: int
    passed: bool = False
    seconds: float = 0.0
    """from the start of the processes to the evaluation that passed, or to the cap"""
    learning_seconds: float | None = None
    """the same from the first step, where it is known"""
    evaluations: list[Point] = field(default_factory=list)
    gymnasium: dict[str, float] = field(default_factory=dict)
    """flights of the policy that passed in Gymnasium's lander: mean return, deviation, episodes"""
    settings: dict[str, Any] = field(default_factory=dict)
    """what of it only the run knows"""

    @property
    def steps(self) -> int:
        """Steps of training that it took."""
        return self.evaluations[-1].steps if self.evaluations else 0

    @property
    def mean_return(self) -> float:
        """Mean return of the last evaluation."""
        return self.evaluations[-1].mean_return if self.evaluations else math.nan
