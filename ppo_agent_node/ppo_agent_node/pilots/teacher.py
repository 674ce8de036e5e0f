# SPDX-License-Identifier: Apache-2.0
"""The pilot that a training imitates."""
from __future__ import annotations

from ppo_agent_node.config.imitation_config import DemonstrationConfig
from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.pilots.scripted import ROCKET_PILOTS
from ppo_agent_node.pilots.scripted import rocket_pilot
from rocket_sim_node.worlds import WorldSpec


def scripted_teacher(spec: WorldSpec, config: DemonstrationConfig) -> Pilot:
    """Return the world's scripted pilot with the gains of the settings.

    :raises ValueError: when it cannot fly the world.
    """
    try:
        teacher = ROCKET_PILOTS[config.teacher] if config.teacher else rocket_pilot(spec)
        return teacher(spec, **config.teacher_gains())
    except ValueError as error:
        raise ValueError(
            f'demonstration_episodes: got {config.demonstration_episodes}, expected 0, as no '
            f'scripted pilot can fly this: {error}') from error
