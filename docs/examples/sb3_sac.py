# SPDX-License-Identifier: Apache-2.0
"""SAC of stable-baselines3 in a world of Hoverslam, in process or over DDS.

python docs/examples/sb3_sac.py --steps 300000
python docs/examples/sb3_sac.py --name hoverslam/Rocket-v1 --curriculum

SAC needs continuous actions, so the lander has its two throttles instead of the four choices.
"""
from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import gymnasium
import torch
from stable_baselines3 import SAC

import rocket_sim_node.gym
from rocket_sim_node.gym.sb3 import HoverslamVecEnv

SETTINGS: dict[str, Any] = {
    'learning_rate': 7e-4, 'batch_size': 256, 'gamma': 0.99, 'tau': 0.01, 'ent_coef': 'auto',
    'learning_starts': 10_000, 'train_freq': 1, 'gradient_steps': 2,
    'policy_kwargs': {'net_arch': [128, 128]}}
"""2 updates for each step of 16 environments, where rl-baselines3-zoo has 1 for each step of one
environment: fewer seconds, more steps"""


def train(
    name: str = rocket_sim_node.gym.IDS['lunar_lander'], num_envs: int = 16,
    steps: int = 300_000, seed: int = 1, simulators: str = '', curriculum: bool = False,
    verbose: int = 1, **settings: Any,
) -> SAC:
    """Train a policy and return the model.

    :param simulators: such as `/sim_*` to fly simulators over DDS; empty: in process.
    :param curriculum: begin episodes near the ground, and ever higher.
    :param settings: of SAC, where they differ from those above.
    """
    torch.set_num_threads(1)
    lander = name == rocket_sim_node.gym.IDS['lunar_lander']
    envs = gymnasium.make_vec(
        name, num_envs=num_envs, seed=seed, simulators=simulators,
        **({'continuous': True} if lander else {}))
    if curriculum:
        envs = rocket_sim_node.gym.ReverseCurriculum(envs)
    env = HoverslamVecEnv(envs)
    try:
        model = SAC(
            'MlpPolicy', env, seed=seed, device='cpu', verbose=verbose,
            **{**SETTINGS, **settings})
        return model.learn(steps)
    finally:
        env.close()


def main() -> None:
    """Train and save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--name', default=rocket_sim_node.gym.IDS['lunar_lander'])
    parser.add_argument('--num-envs', type=int, default=16)
    parser.add_argument('--steps', type=int, default=300_000)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument(
        '--simulators', default='', help='namespaces such as /sim_*; empty: in process')
    parser.add_argument(
        '--curriculum', action='store_true',
        help='begin episodes near the ground, and ever higher')
    parser.add_argument('--output', type=Path, default=Path('sb3_sac.zip'))
    options = vars(parser.parse_args())
    output = options.pop('output')
    output = output if output.suffix else output.with_suffix('.zip')  # as `save` does
    train(**options).save(output)
    print(f'policy: {output}')


if __name__ == '__main__':
    main()
