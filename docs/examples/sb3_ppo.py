# SPDX-License-Identifier: Apache-2.0
"""PPO of stable-baselines3 in a world of Hoverslam, in process or over DDS.

python docs/examples/sb3_ppo.py --steps 2000000
"""
from __future__ import annotations

import argparse
from pathlib import Path

import gymnasium
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

import rocket_sim_node.gym
from rocket_sim_node.gym.sb3 import HoverslamVecEnv


def train(
    name: str = rocket_sim_node.gym.IDS['lunar_lander'], num_envs: int = 16,
    steps: int = 2_000_000, seed: int = 1, simulators: str = '', n_steps: int = 1024,
    verbose: int = 1,
) -> PPO:
    """Train a policy and return the model.

    The settings are those of rl-baselines3-zoo for LunarLander (`hyperparams/ppo.yml`).

    :param simulators: such as `/sim_*` to fly simulators over DDS; empty: in process.
    """
    torch.set_num_threads(1)
    env = VecNormalize(HoverslamVecEnv(
        gymnasium.make_vec(name, num_envs=num_envs, seed=seed, simulators=simulators)))
    try:
        model = PPO(
            'MlpPolicy', env, n_steps=n_steps, batch_size=64, gae_lambda=0.98, gamma=0.999,
            n_epochs=4, ent_coef=0.01, seed=seed, device='cpu', verbose=verbose)
        return model.learn(steps)
    finally:
        env.close()


def main() -> None:
    """Train and save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--name', default=rocket_sim_node.gym.IDS['lunar_lander'])
    parser.add_argument('--num-envs', type=int, default=16)
    parser.add_argument('--steps', type=int, default=2_000_000)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument(
        '--simulators', default='', help='namespaces such as /sim_*; empty: in process')
    parser.add_argument('--output', type=Path, default=Path('sb3_ppo.zip'))
    options = vars(parser.parse_args())
    output = options.pop('output')
    train(**options).save(output)
    print(f'policy: {output}')


if __name__ == '__main__':
    main()
