# SPDX-License-Identifier: Apache-2.0
"""PPO of stable-baselines3 in a world of Hoverslam, in process or over DDS.

python docs/examples/sb3_ppo.py --steps 1000000
python docs/examples/sb3_ppo.py --name hoverslam/Rocket-v1 --curriculum --num-envs 256
"""
from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import gymnasium
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

import rocket_sim_node.gym
from rocket_sim_node.gym.sb3 import HoverslamVecEnv

LANDER: dict[str, Any] = {
    'n_steps': 1024, 'batch_size': 64, 'gae_lambda': 0.98, 'gamma': 0.999, 'n_epochs': 4,
    'ent_coef': 0.01}
"""of rl-baselines3-zoo for LunarLander (`hyperparams/ppo.yml`)"""
ROCKET: dict[str, Any] = {
    'n_steps': 256, 'batch_size': 4096, 'gae_lambda': 0.99, 'gamma': 0.998, 'n_epochs': 3,
    'learning_rate': 1e-3}
"""for the 256 rockets of the command above"""


def train(
    name: str = rocket_sim_node.gym.IDS['lunar_lander'], num_envs: int = 16,
    steps: int = 1_000_000, seed: int = 1, simulators: str = '', curriculum: bool = False,
    verbose: int = 1, **settings: Any,
) -> PPO:
    """Train a policy and return the model.

    :param simulators: such as `/sim_*` to fly simulators over DDS; empty: in process.
    :param curriculum: begin episodes near the ground, and ever higher.
    :param settings: of PPO, where they differ from those above.
    """
    torch.set_num_threads(1)
    envs = gymnasium.make_vec(name, num_envs=num_envs, seed=seed, simulators=simulators)
    if curriculum:
        envs = rocket_sim_node.gym.ReverseCurriculum(envs)
    usual = LANDER if name == rocket_sim_node.gym.IDS['lunar_lander'] else ROCKET
    chosen = {**usual, **settings}
    # Rewards are divided by the deviation of returns, which depends on how these are discounted.
    env = VecNormalize(HoverslamVecEnv(envs), gamma=chosen['gamma'])
    try:
        model = PPO('MlpPolicy', env, seed=seed, device='cpu', verbose=verbose, **chosen)
        return model.learn(steps)
    finally:
        env.close()


def main() -> None:
    """Train and save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--name', default=rocket_sim_node.gym.IDS['lunar_lander'])
    parser.add_argument('--num-envs', type=int, default=16)
    parser.add_argument('--steps', type=int, default=1_000_000)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument(
        '--simulators', default='', help='namespaces such as /sim_*; empty: in process')
    parser.add_argument(
        '--curriculum', action='store_true',
        help='begin episodes near the ground, and ever higher')
    parser.add_argument('--output', type=Path, default=Path('sb3_ppo.zip'))
    options = vars(parser.parse_args())
    output = options.pop('output')
    output = output if output.suffix else output.with_suffix('.zip')  # as `save` does
    model = train(**options)
    model.save(output)
    # The policy is worthless without the means and deviations of its observations.
    statistics = model.get_vec_normalize_env()
    assert statistics is not None
    beside = output.with_name(f'{output.name}.vecnormalize.pkl')
    statistics.save(str(beside))
    print(f'policy: {output}; for VecNormalize.load: {beside}')


if __name__ == '__main__':
    main()
