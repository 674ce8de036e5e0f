# SPDX-License-Identifier: Apache-2.0
"""Which policy of a run is the best: flown without noise, from the same starts each time."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ppo_agent_node.learning import streams
from ppo_agent_node.learning.flights import fly_once
from ppo_agent_node.learning.policies import Policy
from ppo_agent_node.learning.policies import without_noise
from rocket_sim_node.worlds import Episodes
from rocket_sim_node.worlds import VectorEnv


@dataclass(frozen=True)
class Score:
    """How a policy did; the better one has the higher mean return."""

    iteration: int
    episodes: int
    landed: int
    mean_return: float

    @property
    def landing_rate(self) -> float:
        """Part of the episodes that landed."""
        return self.landed / self.episodes


def fly_selection(
    env: VectorEnv,
    policy: Policy,
    iteration: int,
    level: int,
    episodes: int,
    seed: int,
    poll: Callable[[], None],
) -> tuple[Score, int]:
    """Fly at least so many episodes, equally many with each rocket.

    The starts depend on the run's seed alone, so that two policies of a run meet the same ones
    and their difference is less noisy than either; the final evaluation has other starts.

    :return: the score, and the rocket steps that it took.
    :raises EnvironmentRestarted: what was flown is lost; call again with the same arguments.
    """
    parts: list[Episodes] = []
    steps = 0
    for wave in range(-(-episodes // env.spec.num_envs)):
        observation = env.reset(
            streams.derived_seed(seed, 'selection', wave), **({'level': level} if level else {}))
        for step in fly_once(env, observation, without_noise(policy), poll):
            parts.append(step.episodes)
            steps += env.spec.num_envs
    flown = Episodes.concatenate(parts)
    landed = int((flown.outcome == env.spec.outcomes.index('landed')).sum())
    return Score(iteration, len(flown), landed, float(flown.episode_return.mean())), steps
