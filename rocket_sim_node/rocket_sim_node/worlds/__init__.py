# SPDX-License-Identifier: Apache-2.0
"""Vectorised simulations of landing rockets, without ROS.

>>> world = make('rocket', num_envs=256, seed=1, level=7)
>>> observation = world.reset()
"""
from __future__ import annotations

from rocket_sim_node.errors import EnvironmentClosed
from rocket_sim_node.errors import EnvironmentRestarted
from rocket_sim_node.worlds.base import Episodes
from rocket_sim_node.worlds.base import VectorEnv
from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.registry import SteppingSettings
from rocket_sim_node.worlds.registry import full_reach
from rocket_sim_node.worlds.registry import make
from rocket_sim_node.worlds.registry import names
from rocket_sim_node.worlds.registry import reset_settings
from rocket_sim_node.worlds.registry import settings
from rocket_sim_node.worlds.registry import settings_from
from rocket_sim_node.worlds.registry import stepping_settings
from rocket_sim_node.worlds.registry import units

__all__ = [
    'EnvironmentClosed', 'EnvironmentRestarted', 'Episodes', 'SteppingSettings', 'VectorEnv',
    'WorldSpec', 'full_reach', 'make', 'names', 'reset_settings', 'settings', 'settings_from',
    'stepping_settings', 'units',
]
