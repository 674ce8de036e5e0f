# SPDX-License-Identifier: Apache-2.0
"""Categorical policy for discrete actions: softmax over a network's outputs."""
from __future__ import annotations

import math
from collections.abc import Callable
from collections.abc import Sequence

import torch
from torch import Tensor

from ppo_agent_node.ppo.networks.mlp import Normaliser
from ppo_agent_node.ppo.networks.mlp import Perceptron
from ppo_agent_node.ppo.networks.mlp import mlp
from ppo_agent_node.ppo.networks.symmetry import Symmetry
from ppo_agent_node.ppo.policies.base import Likelihood
from ppo_agent_node.ppo.policies.base import Policy


class CategoricalPolicy(Policy):
    """Chooses one of K actions, with softmax probabilities of a network's outputs.

    Weights that are not finite raise an error when an action is chosen: the resulting integer
    could not be recognised as invalid later.
    """

    def __init__(
        self,
        observation_size: int,
        action_count: int,
        hidden_sizes: Sequence[int],
        generator: torch.Generator,
        activation: str = 'tanh',
        symmetry: Symmetry | None = None,
    ) -> None:
        """Create a policy D -> hidden_sizes -> K with nearly equally likely initial actions."""
        super().__init__()
        self.action_shape = ()
        self.action_dtype = torch.int64
        self._actions = action_count
        self.normaliser = Normaliser(observation_size, symmetry=symmetry)
        self.logits = mlp(
            (observation_size, *hidden_sizes, action_count), 0.01, generator, activation,
            () if symmetry is None else symmetry.layers(hidden_sizes, symmetry.actions))

    @torch.no_grad()
    def sampler(
        self, log_prob: Tensor, generator: torch.Generator,
    ) -> Callable[[int, Tensor], Tensor]:
        """Return a function that samples actions `(N,)` int64; see :class:`Policy`.

        The Gumbel-max trick: argmax(log p - log(-log u)) has the probabilities p (Maddison, Tarlow
        and Minka, 'A* sampling', 2014). It uses one uniform number per action, so that the stream
        advances equally whatever is drawn. The function raises ValueError when the network's
        output is not finite.
        """
        # A u of 0 gives minus infinity, which is simply never drawn.
        count = self._actions
        uniform = torch.rand(*log_prob.shape, count, generator=generator)
        gumbel = uniform.log_().neg_().log_().neg_()
        logits = self.quick_output()

        @torch.inference_mode()
        def sample(step: int, observation: Tensor) -> Tensor:
            log_p = _finite(logits(observation).log_softmax(-1))
            action: Tensor = (log_p + gumbel[step]).argmax(-1)
            log_prob[step] = _picked(log_p, action)
            return action

        return sample

    @property
    def network(self) -> Perceptron:
        """The perceptron that outputs the logits."""
        return self.logits

    def likelihood(self, output: Tensor, action: Tensor) -> Likelihood:
        """Return log-probabilities and entropies `(S,)`."""
        log_p = output.log_softmax(0)
        return Likelihood(
            log_p.gather(0, action[None])[0], -(log_p.exp() * log_p).sum(0), log_p)

    def likelihood_gradient(
        self, found: Likelihood, action: Tensor, by_log_prob: Tensor, by_entropy: float,
    ) -> tuple[Tensor, list[Tensor]]:
        """Return the gradient by the logits; there is no noise parameter.

        With H the entropy: d log p_a / d logit_k = [k = a] - p_k and
        d H / d logit_k = -p_k (log p_k + H).
        """
        log_p = found.kept
        error = (log_p + found.entropy).mul_(-by_entropy).sub_(by_log_prob).mul_(log_p.exp())
        return error.scatter_add_(0, action[None], by_log_prob[None]), []

    def most_likely(self, output: Tensor) -> Tensor:
        """Return the most likely actions `(N,)` int64; the first of equally likely ones.

        :raises ValueError: when the network's output is not finite.
        """
        return _finite(output.log_softmax(-1)).argmax(-1)

    def imitation(
        self, output: Tensor, action: Tensor, huber_delta: float = 0.0, margin: float = 0.0,
    ) -> tuple[Tensor, Tensor]:
        """Return the cross entropy, nats, and its gradient: p_k - [k = a]."""
        log_p = output.log_softmax(0)
        chosen = action[None]
        loss = -log_p.gather(0, chosen).sum()
        return loss, log_p.exp().scatter_add(0, chosen, -torch.ones_like(log_p[:1]))


def _finite(log_p: Tensor) -> Tensor:
    """Return log-probabilities `(S, K)` unchanged.

    :raises ValueError: when one is not finite.
    """
    # Their sum is finite, unless one of them is not or they are too large to be added.
    if not math.isfinite(float(log_p.sum())):
        bad = (~log_p.isfinite().all(-1)).nonzero()
        if len(bad):
            raise ValueError(
                f'policy: the probabilities of row {int(bad[0, 0])} are not finite')
    return log_p


def _picked(log_p: Tensor, action: Tensor) -> Tensor:
    """Return the entries `(S,)` of `(S, K)` that belong to actions `(S,)`."""
    return log_p.gather(-1, action[..., None])[..., 0]
