# SPDX-License-Identifier: Apache-2.0
"""stable-baselines3's PPO on Gymnasium's LunarLander-v3 with the settings of its zoo.

The settings are those of rl-baselines3-zoo, `hyperparams/ppo.yml`, entry LunarLander, and the
defaults of stable-baselines3 for everything else.
"""
from __future__ import annotations

import argparse
import time
from typing import Any

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import DummyVecEnv
from stable_baselines3.common.vec_env import SubprocVecEnv

from benchmarks.evaluation import gymnasium_lander
from benchmarks.time_to_result.result_lines import EVALUATION_SEED
from benchmarks.time_to_result.result_lines import VERIFICATION_SEED
from benchmarks.time_to_result.result_lines import StatusPublisher

ENVIRONMENTS = 16
SETTINGS: dict[str, Any] = {
    'n_steps': 1024, 'batch_size': 64, 'gae_lambda': 0.98, 'gamma': 0.999, 'n_epochs': 4,
    'ent_coef': 0.01}
EVALUATED = 100
"""number of episodes in an evaluation"""
INTERVAL = 2
"""roll-outs between two evaluations, 32 768 steps"""
THREADS = 1
"""threads of torch"""


def main() -> None:
    """Learn until an evaluation passes, then fly again."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('--seed', type=int, default=1, help='seed')
    parser.add_argument('--target', type=float, default=200.0, help='mean return at which to stop')
    parser.add_argument('--threads', type=int, default=THREADS, help='threads of torch')
    parser.add_argument('--subprocesses', action='store_true', help='use SubprocVecEnv')
    parser.add_argument('--verify', type=int, default=500, help='episodes after the run')
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    kind = SubprocVecEnv if options.subprocesses else DummyVecEnv
    env = make_vec_env(
        gymnasium_lander.NAME, ENVIRONMENTS, seed=options.seed, vec_env_cls=kind)
    judge = make_vec_env(gymnasium_lander.NAME, ENVIRONMENTS)
    model = PPO('MlpPolicy', env, seed=options.seed, device='cpu', **SETTINGS)
    teller = StatusPublisher(time.monotonic())
    chunk = INTERVAL * ENVIRONMENTS * SETTINGS['n_steps']
    mean = float('-inf')
    while mean < options.target:
        model.learn(chunk, reset_num_timesteps=False)
        judge.seed(EVALUATION_SEED)
        mean = float(evaluate_policy(model, judge, EVALUATED, deterministic=True)[0])
        teller.evaluated(model.num_timesteps, mean)
    if options.verify:
        flown = gymnasium_lander.fly(
            lambda observation: model.predict(observation, deterministic=True)[0],
            options.verify, VERIFICATION_SEED)
        teller.verified(flown.episode_return)
    env.close()


if __name__ == '__main__':
    main()
