# SPDX-License-Identifier: Apache-2.0
"""The scripted pilot of each world: the expert that needs no learning."""
from __future__ import annotations

from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.pilots.estimator.estimator import ExpertEstimator
from ppo_agent_node.pilots.expert.expert import ExpertPilot
from ppo_agent_node.pilots.expert.hoverslam import FLOOR
from ppo_agent_node.pilots.expert.hoverslam import HoverslamPilot
from ppo_agent_node.pilots.lunar_heuristic import LunarHeuristic
from rocket_sim_node.worlds import WorldSpec

ROCKET_PILOTS: dict[str, type[ExpertPilot]] = {
    pilot.name: pilot for pilot in (ExpertPilot, ExpertEstimator, HoverslamPilot)}
"""The pilots of rockets by name."""


def rocket_pilot(spec: WorldSpec) -> type[ExpertPilot]:
    """Return which pilot flies the rockets of a world: another one where engines have a floor."""
    return HoverslamPilot if spec.settings.get(FLOOR, 0.0) > 0 else ExpertPilot


def for_vehicle(pilot: Pilot, spec: WorldSpec) -> Pilot:
    """Return who flies a vehicle: in place of the expert, the pilot for its kind of engine."""
    kind = rocket_pilot(spec) if spec.continuous else ExpertPilot
    return kind(spec) if type(pilot) is ExpertPilot and kind is not ExpertPilot else pilot


def scripted_pilot(spec: WorldSpec, **gains: float) -> Pilot:
    """Return the scripted pilot of a world.

    :param gains: of the rockets' pilot; the lander's has none to be set.
    :raises ValueError: when no scripted pilot here flies the world.
    """
    if spec.name == 'lunar_lander':
        return LunarHeuristic(spec)
    return rocket_pilot(spec)(spec, **gains)
