# SPDX-License-Identifier: Apache-2.0
"""PPO of rsl_rl in a world of Hoverslam, in process or over DDS: pip install rsl-rl-lib.

python docs/examples/rsl_rl_ppo.py --steps 1000000
python docs/examples/rsl_rl_ppo.py --name hoverslam/Rocket-v1 --curriculum --num-envs 256

The PPO of rsl_rl needs continuous actions, so the lander has its two throttles instead of the
four choices.
"""
from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import gymnasium
import torch
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict
from torch import Tensor

import rocket_sim_node.gym


class RslRlEnv(VecEnv):
    """A vector environment for rsl_rl; rewards are in units of 50."""

    def __init__(self, envs: Any) -> None:
        """Wrap an environment that `gymnasium.make_vec` has made."""
        self.envs, self.num_envs = envs, envs.num_envs
        self.num_actions = envs.single_action_space.shape[0]
        self.low, self.high = envs.single_action_space.low, envs.single_action_space.high
        self.device, self.cfg = 'cpu', {}
        self.max_episode_length = 1000
        self.episode_length_buf = torch.zeros(self.num_envs, dtype=torch.long)
        self.observation = envs.reset()[0]

    def get_observations(self) -> TensorDict:
        """Return the current observations."""
        return TensorDict({'policy': torch.as_tensor(self.observation)}, [self.num_envs])

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Any]]:
        """Apply actions; episodes that were truncated are `time_outs`."""
        self.observation, reward, terminated, truncated, info = self.envs.step(
            actions.numpy().clip(self.low, self.high))
        done = torch.as_tensor(terminated | truncated)
        self.episode_length_buf = (self.episode_length_buf + 1) * ~done
        extras: dict[str, Any] = {'time_outs': torch.as_tensor(truncated)}
        if 'final_info' in info and info['_final_info'].any():
            returns = info['final_info']['episode_return'][info['_final_info']]
            extras['log'] = {'/episode/return': float(returns.mean())}
        return self.get_observations(), torch.as_tensor(reward) / 50, done, extras


def settings(num_steps: int) -> dict[str, Any]:
    """Return the configuration of the runner.

    :param num_steps: of each environment in a roll-out.
    """
    network = {
        'class_name': 'MLPModel', 'hidden_dims': [64, 64], 'activation': 'tanh',
        'obs_normalization': True}
    return {
        'num_steps_per_env': num_steps, 'save_interval': 10_000, 'check_for_nan': False,
        'obs_groups': {'actor': ['policy'], 'critic': ['policy']},
        'actor': {**network, 'distribution_cfg': {
            'class_name': 'GaussianDistribution', 'init_std': 0.5, 'std_type': 'log'}},
        'critic': network,
        'algorithm': {
            'class_name': 'PPO', 'num_learning_epochs': 8, 'num_mini_batches': 16,
            'gamma': 0.999, 'lam': 0.98, 'learning_rate': 1e-3, 'schedule': 'adaptive',
            'desired_kl': 0.01, 'entropy_coef': 0.003, 'value_loss_coef': 1.0,
            'max_grad_norm': 1.0}}


def train(
    name: str = rocket_sim_node.gym.IDS['lunar_lander'], num_envs: int = 64,
    steps: int = 1_000_000, seed: int = 1, simulators: str = '', curriculum: bool = False,
    num_steps: int = 64, log: str | None = None,
) -> OnPolicyRunner:
    """Train a policy and return the runner.

    :param simulators: such as `/sim_*` to fly simulators over DDS; empty: in process.
    :param curriculum: begin episodes near the ground, and ever higher.
    :param log: folder for TensorBoard and the policy.
    """
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    lander = name == rocket_sim_node.gym.IDS['lunar_lander']
    envs = gymnasium.make_vec(
        name, num_envs=num_envs, seed=seed, simulators=simulators,
        **({'continuous': True} if lander else {}))
    if curriculum:
        envs = rocket_sim_node.gym.ReverseCurriculum(envs)
    runner = OnPolicyRunner(RslRlEnv(envs), settings(num_steps), log)
    try:
        runner.learn(max(steps // (num_envs * num_steps), 1))
    finally:
        envs.close()
    return runner


def main() -> None:
    """Train; the runner saves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--name', default=rocket_sim_node.gym.IDS['lunar_lander'])
    parser.add_argument('--num-envs', type=int, default=64)
    parser.add_argument('--steps', type=int, default=1_000_000)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument(
        '--simulators', default='', help='namespaces such as /sim_*; empty: in process')
    parser.add_argument(
        '--curriculum', action='store_true',
        help='begin episodes near the ground, and ever higher')
    parser.add_argument('--output', type=Path, default=Path('rsl_rl_ppo'), help='folder')
    options = vars(parser.parse_args())
    output = options.pop('output')
    train(**options, log=str(output))
    print(f'policy: {output}')


if __name__ == '__main__':
    main()
