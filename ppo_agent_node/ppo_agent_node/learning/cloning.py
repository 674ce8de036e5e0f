# SPDX-License-Identifier: Apache-2.0
"""Behavioural cloning: the policy learns to do what the expert did, and is checked on the rest.

Pomerleau, 'Efficient training of artificial neural networks for autonomous navigation', 1991.
"""
from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.optim import Adam

from ppo_agent_node.learning import streams
from ppo_agent_node.learning.demonstrations import Demonstrations
from ppo_agent_node.learning.imitation_config import CloneConfig
from ppo_agent_node.learning.policies import Policy


@dataclass(frozen=True)
class CloneEpoch:
    """How one pass over the demonstrations went."""

    epoch: int
    """from 1"""
    clone_loss: float
    """mean over the samples trained on, while they were"""
    clone_validation_loss: float
    """mean over the samples held out, after the epoch"""
    learning_rate: float
    best: bool
    """whether the validation loss is the least so far"""


def split_by_episode(
    episode: Tensor, fraction: float, generator: torch.Generator,
) -> tuple[Tensor, Tensor]:
    """Return the indices of samples to train on and to validate on.

    Whole episodes are held out: neighbours in time are nearly equal, and a split by sample would
    validate on what was trained on.

    :param episode: `(S,)` the episode of each sample.
    """
    episodes = int(episode.max()) + 1
    held_out = torch.zeros(episodes, dtype=torch.bool)
    count = min(max(1, round(fraction * episodes)), episodes - 1) if fraction > 0 else 0
    held_out[torch.randperm(episodes, generator=generator)[:count]] = True
    validating = held_out[episode]
    return torch.nonzero(~validating)[:, 0], torch.nonzero(validating)[:, 0]


def clone(
    policy: Policy,
    demonstrations: Demonstrations,
    config: CloneConfig,
    seed: int,
    report: Callable[[CloneEpoch], None],
    poll: Callable[[], None] = lambda: None,
) -> float:
    """Train the policy in place and leave it with the weights of its best epoch.

    The learning rate falls to 0 along a half cosine (Loshchilov and Hutter, 'SGDR: stochastic
    gradient descent with warm restarts', 2017). Without episodes to validate on, the training
    loss decides.

    :param report: called after each epoch.
    :param poll: called before each minibatch; may raise to end half-way.
    :return: the least validation loss.
    :raises ValueError: when there are no demonstrations.
    """
    if not len(demonstrations.episode):
        raise ValueError('demonstrations: none landed, nothing to clone')
    training, validation = split_by_episode(
        demonstrations.episode, config.clone_validation_fraction,
        streams.generator(seed, 'clone split'))
    policy.normaliser.fit(demonstrations.observation[training])
    optimiser = Adam(policy.parameters(), lr=config.clone_learning_rate, fused=True)
    batches = -(-len(training) // config.clone_batch_size)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(
        optimiser, batches * config.clone_epochs)
    least, best_epoch = float('inf'), 0
    best_weights = copy.deepcopy(policy.state_dict())
    for epoch in range(1, config.clone_epochs + 1):
        shuffle = streams.generator(seed, 'clone epoch', epoch)
        order = training[torch.randperm(len(training), generator=shuffle)]
        total = torch.zeros(())
        learning_rate = optimiser.param_groups[0]['lr']
        for index in order.split(config.clone_batch_size):
            poll()
            loss = policy.cloning_loss(
                demonstrations.observation[index], demonstrations.action[index])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            total += loss.detach() * len(index)
        training_loss = float(total) / len(training)
        loss_now = training_loss
        if len(validation):
            loss_now = _validation_loss(policy, demonstrations, validation)
        if loss_now < least:
            least, best_epoch = loss_now, epoch
            best_weights = copy.deepcopy(policy.state_dict())
        report(CloneEpoch(epoch, training_loss, loss_now, learning_rate, best_epoch == epoch))
        if epoch - best_epoch >= config.clone_patience:
            break
    policy.load_state_dict(best_weights)
    return least


@torch.no_grad()
def _validation_loss(policy: Policy, demonstrations: Demonstrations, index: Tensor) -> float:
    total = torch.zeros(())
    for part in index.split(8192):
        total += len(part) * policy.cloning_loss(
            demonstrations.observation[part], demonstrations.action[part])
    return float(total) / len(index)
