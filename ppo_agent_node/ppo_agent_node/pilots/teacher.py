# SPDX-License-Identifier: Apache-2.0
"""The pilot that a training imitates."""
from __future__ import annotations

from ppo_agent_node.config.imitation_config import DemonstrationConfig
from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.pilots.scripted import ROCKET_PILOTS
from ppo_agent_node.pilots.scripted import scripted_pilot
from rocket_sim_node.worlds import WorldSpec


def scripted_teacher(spec: WorldSpec, config: DemonstrationConfig) -> Pilot:
    """Return the world's scripted pilot with the gains of the settings.

    :raises ValueError: when it cannot fly the world, or does not have the gains.
    """
    gains = config.teacher_gains()
    if spec.name == 'lunar_lander':
        if config.teacher:
            raise ValueError(
                f"teacher: got {config.teacher!r}, expected '', as lunar_lander has its own pilot")
        if gains:
            name, value = next(iter(gains.items()))
            raise ValueError(
                f'teacher_{name}: got {value:g}, expected -1, as the pilot of lunar_lander has '
                'no gains')
    try:
        if config.teacher:
            return ROCKET_PILOTS[config.teacher](spec, **gains)
        return scripted_pilot(spec, **gains)
    except ValueError as error:
        raise ValueError(
            f'demonstration_episodes: got {config.demonstration_episodes}, expected 0, as no '
            f'scripted pilot can fly this: {error}') from error
