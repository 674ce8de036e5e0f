# SPDX-License-Identifier: Apache-2.0
"""Behavioural cloning: supervised training on the expert's actions, with held-out validation.

Pomerleau, 'Efficient training of artificial neural networks for autonomous navigation', 1991.
"""
from __future__ import annotations

import copy
import math
from collections.abc import Callable
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ppo_agent_node import random_streams
from ppo_agent_node.config.imitation_config import CloneConfig
from ppo_agent_node.imitation.demonstrations import Demonstrations
from ppo_agent_node.ppo.networks.adam import FlatAdam
from ppo_agent_node.ppo.networks.adam import GradientOf
from ppo_agent_node.ppo.networks.backpropagation import Backpropagation
from ppo_agent_node.ppo.parallel import Begin
from ppo_agent_node.ppo.parallel import in_halves
from ppo_agent_node.ppo.parallel import second_thread
from ppo_agent_node.ppo.policies.factory import Policy


class CloningFailed(ValueError):
    """There is no clone: nothing landed, or no epoch had a finite loss."""


@dataclass(frozen=True)
class CloneEpoch:
    """Results of one epoch over the demonstrations."""

    epoch: int
    """From 1."""
    clone_loss: float
    """Mean over the training samples, during the epoch."""
    clone_validation_loss: float
    """Mean over the held-out samples, after the epoch. In rounds of DAgger it is too low: the
    policy has already learnt from most of these episodes."""
    learning_rate: float
    best: bool
    """Whether the validation loss is the lowest so far."""


def split_by_episode(
    episode: Tensor, fraction: float, generator: torch.Generator,
) -> tuple[Tensor, Tensor]:
    """Return the indices of training and validation samples.

    Whole episodes are held out: consecutive samples are nearly equal, so a split by sample would
    validate on training data.

    :param episode: `(S,)` the episode of each sample.
    """
    episodes = int(episode.max()) + 1
    held_out = torch.zeros(episodes, dtype=torch.bool)
    count = min(max(1, round(fraction * episodes)), episodes - 1) if fraction > 0 else 0
    held_out[torch.randperm(episodes, generator=generator)[:count]] = True
    validating = held_out[episode]
    return torch.nonzero(~validating)[:, 0], torch.nonzero(validating)[:, 0]


class CloneGradient:
    """Computes the loss of imitation and its gradient."""

    def __init__(
        self, policy: Policy, config: CloneConfig, gradient_of: GradientOf, seen: Tensor,
        action: Tensor,
    ) -> None:
        """Prepare for pieces of minibatches.

        :param gradient_of: returns the tensor to which a parameter's gradient is added.
        :param seen: `(S, D + F)` normalised observations of all samples.
        :param action: `(S, *action_shape)`.
        """
        self._policy, self._config, self._seen, self._action = policy, config, seen, action
        most = -(-config.clone_batch_size // 2)
        self._network = Backpropagation(policy.network, gradient_of, most)
        self.rows = self._network.rows
        """Maximum number of samples of a piece: half of a minibatch, or less."""

    @torch.no_grad()
    def add(self, pieces: Sequence[Tensor], loss: Tensor) -> None:
        """Add the gradients and the loss of pieces, each the indices of some samples."""
        for piece in pieces:
            found, error = self._imitation(piece)
            self._network.backward(error)
            loss += found

    @torch.no_grad()
    def add_loss(self, pieces: Sequence[Tensor], loss: Tensor) -> None:
        """Add the loss of pieces, and leave the gradient as it is."""
        for piece in pieces:
            loss += self._imitation(piece)[0]

    def _imitation(self, piece: Tensor) -> tuple[Tensor, Tensor]:
        return self._policy.imitation(
            self._network.forward(self._seen.index_select(0, piece)),
            self._action.index_select(0, piece),
            self._config.clone_huber_delta, self._config.clone_margin)


@torch.no_grad()
def clone(
    policy: Policy,
    demonstrations: Demonstrations,
    config: CloneConfig,
    seed: int,
    report: Callable[[CloneEpoch], None],
    poll: Callable[[], None] = lambda: None,
    normalised: bool = False,
) -> float:
    """Train the policy and leave it with the weights of its best epoch.

    The learning rate falls to 0 along a half cosine (Loshchilov and Hutter, 'SGDR: stochastic
    gradient descent with warm restarts', 2017). Without validation episodes, the training loss
    is used to select the best epoch. Two threads share each minibatch if the tensor library has
    two; one and two threads compute the same bits.

    :param report: called after each epoch.
    :param poll: called before each minibatch; may raise to abort, leaving the policy unchanged.
    :param normalised: whether the observations are those of the policy's normaliser already. If
        not, it is fitted to them first, which would invalidate earlier training.
    :return: the lowest validation loss.
    :raises CloningFailed: when there are no demonstrations, or no epoch had a finite loss; the
        policy is unchanged.
    """
    if not len(demonstrations.episode):
        raise CloningFailed('demonstrations: none landed, nothing to clone')
    training, validation = split_by_episode(
        demonstrations.episode, config.clone_validation_fraction,
        random_streams.generator(seed, 'clone split'))
    # The optimiser stores its network's parameters in its own memory.
    student = copy.deepcopy(policy)
    seen = demonstrations.observation
    if not normalised:
        student.normaliser.fit(seen[training])
        seen = student.normaliser.of_many(seen)
    optimiser = FlatAdam(
        [list(student.network.parameters())], epsilon=1e-8, ties=student.network.ties())
    other_half, other_gradient_of = optimiser.partial_gradient()
    gradient, other_gradient = (
        CloneGradient(student, config, gradient_of, seen, demonstrations.action)
        for gradient_of in (optimiser.gradient_of, other_gradient_of))
    size = config.clone_batch_size
    steps = config.clone_epochs * -(-len(training) // size)
    step = 0

    def learning_rate() -> float:
        return config.clone_learning_rate * 0.5 * (1 + math.cos(math.pi * step / steps))

    def validation_loss(begin: Begin) -> float:
        losses = torch.zeros(2)
        in_halves(begin, validation.split(gradient.rows),
                  lambda half: gradient.add_loss(half, losses[0]),
                  lambda half: other_gradient.add_loss(half, losses[1]))
        return float(losses.sum()) / len(validation)

    def learn_from(minibatch: Tensor, losses: Tensor, begin: Begin) -> None:
        pieces = minibatch.chunk(-(-len(minibatch) // gradient.rows))
        optimiser.gradient.zero_()
        other_half.zero_()
        in_halves(begin, pieces, lambda half: gradient.add(half, losses[0]),
                  lambda half: other_gradient.add(half, losses[1]))
        optimiser.gradient.add_(other_half)
        optimiser.step([learning_rate()], math.inf, len(minibatch))

    least, best_epoch = math.inf, 0
    best_weights = copy.deepcopy(student.state_dict())
    with second_thread() as begin:
        for epoch in range(1, config.clone_epochs + 1):
            shuffle = random_streams.generator(seed, 'clone epoch', epoch)
            order = training[torch.randperm(len(training), generator=shuffle)]
            rate = learning_rate()
            losses = torch.zeros(2)
            for minibatch in order.split(size):
                poll()
                learn_from(minibatch, losses, begin)
                step += 1
            training_loss = float(losses.sum()) / len(training)
            loss_now = validation_loss(begin) if len(validation) else training_loss
            if loss_now < least:
                least, best_epoch = loss_now, epoch
                best_weights = copy.deepcopy(student.state_dict())
            report(CloneEpoch(epoch, training_loss, loss_now, rate, best_epoch == epoch))
            if epoch - best_epoch >= config.clone_patience:
                break
    if not best_epoch:
        raise CloningFailed(
            f'clone_learning_rate: got {config.clone_learning_rate:g}, expected one with which '
            'cloning has a finite loss; the loss of each epoch was infinite or NaN')
    policy.load_state_dict(best_weights)
    return least

