# SPDX-License-Identifier: Apache-2.0
"""Selection of a world's scripted pilot."""
from __future__ import annotations

from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.pilots.estimator.estimator import ExpertEstimator
from ppo_agent_node.pilots.expert.expert import ExpertPilot
from ppo_agent_node.pilots.expert.expert import ExpertSettings
from ppo_agent_node.pilots.expert.hoverslam import FLOOR
from ppo_agent_node.pilots.expert.hoverslam import HoverslamPilot
from ppo_agent_node.pilots.lunar_heuristic import LunarHeuristic
from rocket_sim_node.worlds import WorldSpec

ROCKET_PILOTS: dict[str, type[ExpertPilot]] = {
    pilot.name: pilot for pilot in (ExpertPilot, ExpertEstimator, HoverslamPilot)}
"""Pilots of rockets by name."""


def rocket_pilot(spec: WorldSpec) -> type[ExpertPilot]:
    """Return the pilot for a world's rockets: another one if they have a minimum throttle."""
    return HoverslamPilot if spec.settings.get(FLOOR, 0.0) > 0 else ExpertPilot


def for_vehicle(pilot: Pilot, spec: WorldSpec) -> Pilot:
    """Return the pilot for a vehicle: replaces the expert by the one for its kind of engine.

    An expert with other gains than the default ones, such as tuned gains, is not replaced.
    """
    kind = rocket_pilot(spec) if spec.continuous else ExpertPilot
    usual = type(pilot) is ExpertPilot and pilot.settings == ExpertSettings()
    return kind(spec) if usual and kind is not ExpertPilot else pilot


def scripted_pilot(spec: WorldSpec) -> Pilot:
    """Return the scripted pilot of a world, with its default gains.

    :raises ValueError: when there is no scripted pilot for the world.
    """
    if spec.name == 'lunar_lander':
        return LunarHeuristic(spec)
    return rocket_pilot(spec)(spec)
