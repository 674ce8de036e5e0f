# SPDX-License-Identifier: Apache-2.0
"""Figures of flights: counted while they are flown, or read from the file of an evaluation."""
from __future__ import annotations

import json
import math
import time
from pathlib import Path

from rocket_msgs.msg import Episodes
from rocket_msgs.msg import FlightFigures

from ppo_agent_node.statistics import wilson
from ppo_agent_node.terminal import formatting
from rocket_sim_node.telemetry.training_status import Status

LANDED = 0
"""Code of the outcome `landed`, in every world."""


class EpisodeStatistics:
    """Episodes of a goal so far."""

    def __init__(self, planned: int, level: int, command: str) -> None:
        """Start with no episodes.

        :param planned: number of episodes to be flown, 0: unknown.
        :param level: curriculum level for the text, 0: unknown.
        :param command: that flies them, `evaluate` or `land`.
        """
        self._planned, self._level, self._command = planned, level, command
        self._count, self._landed, self._sum = 0, 0, 0.0
        self._began = time.monotonic()

    def add(self, message: Episodes) -> None:
        """Add episodes that have ended."""
        self._count += len(message.outcome)
        self._landed += sum(code == LANDED for code in message.outcome)
        self._sum += sum(message.episode_return)

    def figures(self) -> FlightFigures:
        """Return the figures so far."""
        if not self._count:
            return no_figures()
        low, high = wilson(self._landed, self._count)
        return FlightFigures(
            episodes=self._count, landed=self._landed, landing_rate=self._landed / self._count,
            landing_rate_low=low, landing_rate_high=high, mean_return=self._sum / self._count)

    def text(self) -> str:
        """Return progress and figures as one line."""
        found = self.figures()
        elapsed = time.monotonic() - self._began
        left = elapsed * (self._planned / self._count - 1) if self._count else math.inf
        return formatting.line(Status(
            stage=self._command, iteration=min(self._count, self._planned or self._count),
            iterations=self._planned, unit='episodes', level=self._level, elapsed=elapsed,
            remaining=max(0.0, left) if self._planned else math.inf,
            landing_rate=found.landing_rate, landing_rate_low=found.landing_rate_low,
            landing_rate_high=found.landing_rate_high, mean_return=found.mean_return))


def no_figures() -> FlightFigures:
    """Return the figures of no episodes."""
    return FlightFigures(
        landing_rate=math.nan, landing_rate_low=math.nan, landing_rate_high=math.nan,
        mean_return=math.nan)


def read_figures(path: Path) -> FlightFigures:
    """Return the figures in the file of an evaluation.

    :raises OSError: when it cannot be read.
    """
    found = json.loads(path.read_text('utf-8'))
    low, high = found['landing_rate_interval']
    return FlightFigures(
        episodes=found['episodes'], landed=found['landed'], landing_rate=found['landing_rate'],
        landing_rate_low=low, landing_rate_high=high, mean_return=found['mean_return'])
