# SPDX-License-Identifier: Apache-2.0
"""Measures how well policy gradients from different roll-outs agree, by kind of exploration.

Several roll-outs of a policy give a gradient each. The agreement is the mean dot product of two of
them over their mean square: 1 if all are the same, 0 if they have nothing in common. Its standard
error is that of the jackknife (Efron, 'The jackknife, the bootstrap and other resampling plans',
1982). The deviation is that of the returns of a start's copies, which differ in their noise alone.
"""
from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import ppo_agent_node
from benchmarks import machine
from ppo_agent_node import random_streams
from ppo_agent_node.evaluation.conditions_files import aligned
from ppo_agent_node.evaluation.metrics import write_json
from ppo_agent_node.ppo.episode_rollout import EpisodeRollout
from ppo_agent_node.ppo.policies.factory import GaussianPolicy
from ppo_agent_node.ppo.policies.file import load_policy
from ppo_agent_node.ppo.rollout_buffer import Batch
from rocket_sim_node import worlds
from rocket_sim_node.worlds import VectorEnv
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import fly
from rocket_sim_node.worlds.rocket import conditions

POLICY = Path(ppo_agent_node.__file__).parent / 'policies' / 'robust.safetensors'
EXPLORATIONS = ('independent', 'state_dependent')


def gradient(policy: GaussianPolicy, batch: Batch) -> Tensor:
    """Return the gradient of the advantage-weighted log-probability by all weights, flat."""
    with torch.enable_grad():
        log_prob, _ = policy.log_prob_entropy(batch.observation, batch.action)
        loss = (log_prob * batch.advantage).sum()
        found = torch.autograd.grad(loss, list(policy.network.parameters()))
    return torch.cat([one.flatten() for one in found]).double()


def agreement(gradients: list[Tensor]) -> tuple[float, float]:
    """Return the mean dot product of two gradients over their mean square, and its error."""
    products = torch.stack(gradients) @ torch.stack(gradients).T
    count = len(gradients)

    def of(some: Tensor) -> float:
        found = products[some][:, some]
        own = found.trace()
        return float((found.sum() - own) / (len(some) - 1) / own)

    every = torch.arange(count)
    without = [of(every[every != one]) for one in every]
    return of(every), math.sqrt((count - 1) * float(np.var(without)))


def measure(
    env: VectorEnv, policy: GaussianPolicy, options: argparse.Namespace, exploration: str,
    log_std: float,
) -> dict[str, Any]:
    """Fly the roll-outs with one kind of noise and return their figures."""
    policy.noise_lasts = exploration == 'state_dependent'
    with torch.no_grad():
        policy.log_std.fill_(log_std)
    settings = {**conditions.settings(options.conditions), 'level': options.level,
                'spawn_copies': options.copies}
    gradients: dict[bool, list[Tensor]] = {True: [], False: []}
    rollout = EpisodeRollout(env.spec.num_envs, options.copies)
    returns = []
    for number in range(options.rollouts):
        seed = options.seed + number
        ended, _ = fly(env, rollout.flight(
            0, Reset(seed, settings), policy, random_streams.generator(seed, 'gradients')))
        for normalise, found in gradients.items():
            rollout.normalise_starts = normalise
            batch = rollout.batch(lambda seen: seen[:, 0], options.gamma, 1.0, 1.0)
            found.append(gradient(policy, batch))
        by_row = np.zeros(env.spec.num_envs)
        for _, episodes in ended:
            by_row[episodes.row] = episodes.episode_return
        returns.append(by_row)
    each = np.concatenate(returns)
    return {
        'exploration': exploration, 'log_std': log_std, 'mean_return': float(each.mean()),
        'deviation': float(np.median(each.reshape(-1, options.copies).std(1))),
        'agreement': agreement(gradients[False]),
        'agreement_normalised': agreement(gradients[True])}


def main() -> None:
    """Measure each kind of noise, and print and write the figures."""
    parser = argparse.ArgumentParser(prog='bench gradients', description=__doc__)
    parser.add_argument('--policy', type=Path, default=POLICY,
                        help="policy file, such as a run's cloned.safetensors")
    parser.add_argument('--world', default='rocket', choices=('rocket', 'rocket_planar'),
                        help='world')
    parser.add_argument('--conditions', default='mix', choices=conditions.NAMES,
                        help='conditions')
    parser.add_argument('--level', type=int, default=7, help='level')
    parser.add_argument('--log-std', type=float, nargs='+', default=[-2.5, -3.5, -4.5, -5.5],
                        help='log standard deviations of the noise')
    parser.add_argument('--gamma', type=float, default=0.95, help='discount of the advantages')
    parser.add_argument('--rollouts', type=int, default=24, help='roll-outs, 3 or more')
    parser.add_argument('--rockets', type=int, default=256, help='rockets of a roll-out')
    parser.add_argument('--copies', type=int, default=8, help='rockets that fly each start')
    parser.add_argument('--seed', type=int, default=700_000, help='seed of the first roll-out')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    if options.rollouts < 3:
        parser.error(f'--rollouts: got {options.rollouts}, expected 3 or more')
    if options.copies < 2 or options.rockets % options.copies:
        parser.error(f'--copies: got {options.copies}, expected 2 or more and a divisor of '
                     f'--rockets, {options.rockets}')
    torch.set_num_threads(1)
    env = worlds.make(options.world, options.rockets, observation='extended')
    policy, description = load_policy(options.policy, env.spec)
    if len(description['observation_names']) < env.spec.observation_size:
        env = worlds.make(options.world, options.rockets)
    if not isinstance(policy, GaussianPolicy):
        parser.error(f'{options.policy}: its actions are discrete, expected continuous ones')
    found = []
    lines = [['noise', 'log std', 'mean return', 'deviation of copies', 'agreement',
              'normalised by start']]
    for exploration in EXPLORATIONS:
        for log_std in options.log_std:
            one = measure(env, policy, options, exploration, log_std)
            found.append(one)
            lines.append([exploration, f'{log_std:g}', f'{one["mean_return"]:.2f}',
                          f'{one["deviation"]:.2f}', *(
                '{:.3f} ± {:.3f}'.format(*one[name])
                for name in ('agreement', 'agreement_normalised'))])
            print(' '.join(lines[-1]), flush=True)
    print(f'\n{aligned(lines)}')
    if options.output:
        write_json(options.output, {'commit': machine.commit(), 'flown': found})


if __name__ == '__main__':
    main()
