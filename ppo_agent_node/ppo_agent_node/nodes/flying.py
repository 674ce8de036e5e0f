# SPDX-License-Identifier: Apache-2.0
"""Flying a simulator with a pilot that does not learn, for as long as wanted."""
from __future__ import annotations

import time

from rclpy.node import Node

from ppo_agent_node.pilots.base import Pilot
from rocket_sim_node.wire.client import Client
from rocket_sim_node.worlds import EnvironmentClosed
from rocket_sim_node.worlds import EnvironmentRestarted
from rocket_sim_node.worlds import Episodes

_REPORT_PERIOD = 5.0
"""s between two lines on the log"""


def fly(
    node: Node, client: Client, pilot: Pilot, seed: int, episodes: int, **settings: float,
) -> Episodes:
    """Fly until `episodes` have ended (0: for ever), or this process is asked to end; return them.

    A simulator that comes back is reset and flown on.
    """
    finished: list[Episodes] = []
    count = 0
    outcomes = client.spec.outcomes
    observation = None
    report = time.monotonic() + _REPORT_PERIOD
    while not episodes or count < episodes:
        try:
            if observation is None:
                observation = client.reset(seed, **settings)
            observation, _, _, _, info = client.step(pilot(observation))
        except EnvironmentRestarted as error:
            node.get_logger().warning(f'{error}: starting anew')
            observation = None
            continue
        except EnvironmentClosed:
            break
        ended: Episodes = info['episodes']
        if len(ended):
            finished.append(ended)
            count += len(ended)
        if time.monotonic() > report and finished:
            report = time.monotonic() + _REPORT_PERIOD
            node.get_logger().info(summary(Episodes.concatenate(finished), outcomes))
            finished = finished if episodes else []
    return Episodes.concatenate(finished)


def summary(episodes: Episodes, outcomes: tuple[str, ...]) -> str:
    """Return one line about episodes: how many ended how, and the mean return."""
    counts = [
        f'{name} {int((episodes.outcome == number).sum())}'
        for number, name in enumerate(outcomes) if (episodes.outcome == number).any()
    ]
    mean = episodes.episode_return.mean() if len(episodes) else float('nan')
    return f'{len(episodes)} episodes: {", ".join(counts) or "none"}; mean return {mean:.1f}'
