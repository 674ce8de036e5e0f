# SPDX-License-Identifier: Apache-2.0
"""PPO of TorchRL in a world of Hoverslam, in process or over DDS: pip install torchrl.

python docs/examples/torchrl_ppo.py --steps 1000000
python docs/examples/torchrl_ppo.py --name hoverslam/Rocket-v1 --curriculum --num-envs 256
"""
from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import gymnasium
import torch
from tensordict.nn import AddStateIndependentNormalScale
from tensordict.nn import TensorDictModule
from torch import nn
from torch.distributions import Categorical
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage
from torchrl.data import TensorDictReplayBuffer
from torchrl.data.replay_buffers.samplers import SamplerWithoutReplacement
from torchrl.envs import Compose
from torchrl.envs import GymWrapper
from torchrl.envs import RewardScaling
from torchrl.envs import RewardSum
from torchrl.envs import TransformedEnv
from torchrl.modules import MLP
from torchrl.modules import IndependentNormal
from torchrl.modules import ProbabilisticActor
from torchrl.modules import ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import rocket_sim_node.gym


def make_models(env: TransformedEnv) -> tuple[ProbabilisticActor, ValueOperator]:
    """Return an actor for the action space of an environment, and a critic."""
    discrete = not env.action_spec_unbatched.dtype.is_floating_point
    size = env.observation_spec_unbatched['observation'].shape[-1]
    actions = (
        env.action_spec_unbatched.space.n if discrete else env.action_spec_unbatched.shape[-1])
    networks = [
        MLP(size, outputs, num_cells=[64, 64], activation_class=nn.Tanh)
        for outputs in (actions, 1)]
    for network in networks:
        for layer in network:
            if isinstance(layer, nn.Linear):
                nn.init.orthogonal_(layer.weight, 2**0.5)
                nn.init.zeros_(layer.bias)
    nn.init.orthogonal_(networks[0][-1].weight, 0.01)
    keys, kind = ['logits'], Categorical
    if not discrete:
        networks[0].append(AddStateIndependentNormalScale(actions, scale_mapping='exp'))
        keys, kind = ['loc', 'scale'], IndependentNormal
    actor = ProbabilisticActor(
        TensorDictModule(networks[0], ['observation'], keys), in_keys=keys,
        spec=env.action_spec_unbatched, distribution_class=kind, return_log_prob=True)
    return actor, ValueOperator(networks[1], ['observation'])


def train(
    name: str = rocket_sim_node.gym.IDS['lunar_lander'], num_envs: int = 64,
    steps: int = 1_000_000, seed: int = 1, simulators: str = '', curriculum: bool = False,
    num_steps: int = 64, epochs: int = 8, minibatches: int = 16,
    learning_rate: float = 2e-3,
) -> ProbabilisticActor:
    """Train a policy and return it.

    :param simulators: such as `/sim_*` to fly simulators over DDS; empty: in process.
    :param curriculum: begin episodes near the ground, and ever higher.
    """
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    envs: Any = gymnasium.make_vec(name, num_envs=num_envs, seed=seed, simulators=simulators)
    if curriculum:
        envs = rocket_sim_node.gym.ReverseCurriculum(envs)
    env = TransformedEnv(
        GymWrapper(envs, categorical_action_encoding=True),
        Compose(RewardSum(), RewardScaling(0.0, 0.02)))
    actor, critic = make_models(env)
    each = num_envs * num_steps
    collector = Collector(
        env, actor, frames_per_batch=each, total_frames=max(steps // each, 1) * each)
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(each), sampler=SamplerWithoutReplacement(),
        batch_size=each // minibatches)
    advantage = GAE(gamma=0.999, lmbda=0.98, value_network=critic)
    loss = ClipPPOLoss(
        actor, critic, clip_epsilon=0.2, entropy_coeff=0.003, critic_coeff=0.5,
        loss_critic_type='l2', normalize_advantage=True)
    optimiser = torch.optim.Adam(loss.parameters(), learning_rate, eps=1e-5)
    flown = 0
    try:
        for data in collector:
            for _ in range(epochs):
                with torch.no_grad():
                    data = advantage(data)
                buffer.extend(data.reshape(-1))
                for batch in buffer:
                    losses = loss(batch)
                    optimiser.zero_grad()
                    (losses['loss_objective'] + losses['loss_critic']
                     + losses['loss_entropy']).backward()
                    nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
                    optimiser.step()
            collector.update_policy_weights_()
            flown += data.numel()
            returns = data['next', 'episode_reward'][data['next', 'done']]
            mean = f'{returns.mean():.1f}' if len(returns) else 'none yet'
            print(f'{flown} steps, return {mean}')
    finally:
        collector.shutdown()
        envs.close()
    return actor


def main() -> None:
    """Train and save."""
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
    parser.add_argument('--output', type=Path, default=Path('torchrl_ppo.pt'))
    options = vars(parser.parse_args())
    output = options.pop('output')
    torch.save(train(**options).state_dict(), output)
    print(f'policy: {output}')


if __name__ == '__main__':
    main()
