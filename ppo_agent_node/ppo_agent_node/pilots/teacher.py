# SPDX-License-Identifier: Apache-2.0
"""The pilot that a training imitates."""
from __future__ import annotations

from ppo_agent_node.config.imitation_config import DemonstrationConfig
from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.pilots.scripted import ROCKET_PILOTS
from ppo_agent_node.pilots.scripted import rocket_pilot
from ppo_agent_node.pilots.scripted import scripted_pilot
from rocket_sim_node import settings as settings_module
from rocket_sim_node.worlds import WorldSpec


def scripted_teacher(
    spec: WorldSpec, config: DemonstrationConfig, wide: WorldSpec | None = None,
) -> Pilot:
    """Return the world's scripted pilot with the gains of the settings.

    :param wide: the world of curriculum_wide_level, if there is one.
    :raises ValueError: when it cannot fly the world, does not have the gains or one is out of
        range, or when the wide world needs another pilot and the settings name none.
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
        return scripted_pilot(spec)
    kind = ROCKET_PILOTS[config.teacher] if config.teacher else rocket_pilot(spec)
    try:
        # Before the pilot does so, whose errors are those of the vehicle.
        settings_module.build(kind.settings_class, gains)
    except ValueError as error:
        raise ValueError(f'teacher_{error}') from error
    if wide is not None and not config.teacher and rocket_pilot(wide) is not kind:
        raise ValueError(
            "teacher: got '', expected the name of one pilot for all demonstrations: "
            f'{kind.name} flies the engine of conditions, {rocket_pilot(wide).name} that of '
            'curriculum_wide_conditions')
    try:
        return kind(spec, **gains)
    except ValueError as error:
        raise ValueError(
            f'demonstration_episodes: got {config.demonstration_episodes}, expected 0, as no '
            f'scripted pilot can fly this: {error}') from error
