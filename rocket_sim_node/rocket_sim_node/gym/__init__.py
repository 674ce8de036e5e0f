# SPDX-License-Identifier: Apache-2.0
"""The worlds as Gymnasium environments; importing this package registers them.

>>> import gymnasium
>>> import rocket_sim_node.gym
>>> envs = gymnasium.make_vec('hoverslam/Rocket-v1', num_envs=256, level=7)
>>> env = gymnasium.make('hoverslam/LunarLander-v1')
"""
from __future__ import annotations

from rocket_sim_node.gym.curriculum import ReverseCurriculum
from rocket_sim_node.gym.registration import IDS
from rocket_sim_node.gym.registration import register
from rocket_sim_node.gym.single_env import HoverslamEnv
from rocket_sim_node.gym.vector_env import HoverslamVectorEnv

register()

__all__ = ['IDS', 'HoverslamEnv', 'HoverslamVectorEnv', 'ReverseCurriculum', 'register']
