# SPDX-License-Identifier: Apache-2.0
"""Registration of the worlds with Gymnasium."""
from __future__ import annotations

import gymnasium

IDS = {
    'rocket': 'hoverslam/Rocket-v1',
    'rocket_planar': 'hoverslam/RocketPlanar-v1',
    'lunar_lander': 'hoverslam/LunarLander-v1',
}
"""Names of the environments in Gymnasium, by world."""


def register() -> None:
    """Register the worlds with Gymnasium, once; importing `rocket_sim_node.gym` calls this.

    It is also the entry point `hoverslam` of the group `gymnasium.envs`. Gymnasium itself has not
    read this group since 1.0, but other programs that look for environments do.
    """
    for world, name in IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name, entry_point='rocket_sim_node.gym.single_env:HoverslamEnv',
                vector_entry_point='rocket_sim_node.gym.vector_env:HoverslamVectorEnv',
                kwargs={'world': world})
