# SPDX-License-Identifier: Apache-2.0
"""The scripted pilot of each world: the expert that needs no learning."""
from __future__ import annotations

from ppo_agent_node.pilots.base import Pilot
from ppo_agent_node.pilots.expert import ExpertPilot
from ppo_agent_node.pilots.lunar_heuristic import LunarHeuristic
from rocket_sim_node.worlds import WorldSpec


def scripted_pilot(spec: WorldSpec, **gains: float) -> Pilot:
    """Return the scripted pilot of a world.

    :param gains: of :class:`ExpertPilot`; the lander's pilot has none to be set.
    :raises ValueError: when no scripted pilot here flies the world.
    """
    if spec.name == 'lunar_lander':
        return LunarHeuristic(spec)
    return ExpertPilot(spec, **gains)
