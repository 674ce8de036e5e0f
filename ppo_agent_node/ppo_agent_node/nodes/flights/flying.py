# SPDX-License-Identifier: Apache-2.0
"""Continuous flight of a pilot that does not learn."""
from __future__ import annotations

import time

import numpy as np
from rclpy.node import Node

from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.flying.pilot import tell_begun
from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.worlds import EnvironmentClosed
from rocket_sim_node.worlds import EnvironmentRestarted
from rocket_sim_node.worlds import Episodes

_REPORT_PERIOD = 5.0
"""Seconds between two log lines."""


class OutcomeCounts:
    """Counts of episodes by outcome."""

    def __init__(self, outcomes: tuple[str, ...]) -> None:
        """Count from 0."""
        self._outcomes = outcomes
        self._counts = np.zeros(len(outcomes), np.int64)
        self._return = 0.0

    @property
    def count(self) -> int:
        """Number of episodes."""
        return int(self._counts.sum())

    def add(self, ended: Episodes) -> None:
        """Add ended episodes."""
        self._counts += np.bincount(ended.outcome, minlength=len(self._outcomes))
        self._return += float(ended.episode_return.sum())

    def __str__(self) -> str:
        """Return one line: episodes by outcome, and the mean return."""
        counts = [f'{name} {count}' for name, count in zip(
            self._outcomes, self._counts.tolist(), strict=True) if count]
        mean = self._return / self.count if self.count else float('nan')
        return f'{self.count} episodes: {", ".join(counts) or "none"}; mean return {mean:.1f}'


def fly(
    node: Node, client: Client, pilot: Pilot, seed: int, episodes: int, **settings: float,
) -> None:
    """Fly until `episodes` have ended (0: forever), or this process is asked to stop.

    The first episodes that end count, of any rocket; `evaluation.runner` avoids that bias. The log
    has a line every few seconds on the episodes since the last line, if flying forever, and
    finally one on all of them. A simulator that restarts is reset and flown on, from other starts.
    """
    outcomes = client.spec.outcomes
    total, recent = OutcomeCounts(outcomes), OutcomeCounts(outcomes)
    observation = None
    report = time.monotonic() + _REPORT_PERIOD
    while not episodes or total.count < episodes:
        try:
            if observation is None:
                observation = client.reset(seed, **settings)
                tell_begun(pilot)
            observation, _, _, _, info = client.step(pilot(observation))
            tell_begun(pilot, info['final_rows'])
        except EnvironmentRestarted as error:
            node.get_logger().warning(f'{error}: starting again')
            observation = None
            seed += 1  # the episodes flown so far are already counted
            continue
        except EnvironmentClosed:
            break
        if len(info['episodes']):
            total.add(info['episodes'])
            recent.add(info['episodes'])
        if time.monotonic() > report and recent.count:
            report = time.monotonic() + _REPORT_PERIOD
            node.get_logger().info(str(total if episodes else recent))
            recent = OutcomeCounts(outcomes)
    node.get_logger().info(str(total))
