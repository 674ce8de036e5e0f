# SPDX-License-Identifier: Apache-2.0
"""Roll-outs of whole episodes, with each start flown several times as its own baseline.

The mean return of a start's copies estimates its value, without a critic. Near an optimum that is
decisive: a critic's error of 0.1 hides the thousandths by which actions differ there, while the
copies of a start differ by their actions alone.

The advantage of an episode is its return less the mean of the other copies (the leave-one-out
baseline of Kool, van Hoof and Welling, 'Buy 4 REINFORCE samples, get a baseline
for free!', 2019). With `normalise_starts` it is divided by their standard deviation, as in group
relative policy optimization (Shao et al., 'DeepSeekMath', 2024, section 4.1), so that all starts
count alike. Otherwise a start counts the more, the more its copies differ, up to a limit, as it
does in the gradient of the mean return (Liu et al., 'Understanding R1-Zero-like training', 2025,
section 3).

The last step of an episode gets the whole advantage, a step k earlier gamma^k of it: the rewards
are paid at the end, and feedback corrects most of what an early action's noise did, so that early
steps would contribute more noise than signal. Steps so early that less than a thousandth is left
are no samples: their gradient is negligible, and they would cost as much as the others.
"""
from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from ppo_agent_node.ppo.policies.factory import Policy
from ppo_agent_node.ppo.rollout_buffer import Batch
from ppo_agent_node.ppo.rollout_buffer import Ended
from rocket_sim_node.worlds import Episodes
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.jobs import Act
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import Restore
from rocket_sim_node.worlds.jobs import Results
from rocket_sim_node.worlds.jobs import Snapshot

_CHUNK = 128
"""Number of steps whose random numbers are drawn at once."""
_LEAST_DEVIATION = 0.02
"""Added to the standard deviation of copies' returns: smaller differences are rounding and
luck."""
_LIMIT = 4.0
"""Maximum advantage, in units of the 90th percentile: one crash among landings is informative, but
the many steps of its episode would otherwise dominate the batch."""

_LEAST_WEIGHT = 1e-3
"""Minimum of gamma^k for a step to be a sample."""


def relative_advantages(returns: F64, copies: int, normalise: bool = True) -> F64:
    """Return the advantages `(E,)` of episodes relative to the copies of their starts.

    :param returns: `(E,)`, the copies of a start consecutively.
    :param copies: K, number of copies, 2 or more.
    :param normalise: whether to divide those of a start by the standard deviation of its copies'
        returns.
    """
    groups = returns.reshape(-1, copies)
    relative = (groups - groups.mean(1, keepdims=True)) * (copies / (copies - 1))
    if normalise:
        relative /= groups.std(1, keepdims=True) + _LEAST_DEVIATION
    scale = np.quantile(np.abs(relative), 0.9)
    advantage: F64 = np.clip(relative / max(scale, 1e-6), -_LIMIT, _LIMIT).ravel()
    return advantage


class EpisodeRollout:
    """One episode of each of N rockets in G groups; same interface as `rollout_buffer.Rollout`."""

    def __init__(
        self, rockets: int, copies: int, groups: int = 1, normalise_starts: bool = True,
    ) -> None:
        """Prepare for N rockets in each of G groups; every K consecutive ones share a start.

        :param normalise_starts: the `normalise` of `relative_advantages`.
        :raises ValueError: when K does not divide N.
        """
        if rockets % copies:
            raise ValueError(
                f"start_copies: got {copies}, expected a divisor of the simulator's num_envs, "
                f'{rockets}')
        self._copies = copies
        self.normalise_starts = normalise_starts
        """Applies to the next batch."""
        self._flown: list[list[tuple[Tensor, Tensor, Tensor, Tensor]]] = [[]] * groups
        self._returns = np.zeros((groups, rockets))
        self._last = np.zeros((groups, rockets), np.int64)

    @property
    def steps(self) -> int:
        """Rocket steps of the last roll-out, of all groups, those after an episode included.

        Less the last step, which is taken while the results of the one before arrive.
        """
        return sum(map(len, self._flown)) * self._returns.shape[1]

    def flight(
        self, group: int, begin: Reset | Restore, policy: Policy, generator: torch.Generator,
    ) -> Job[tuple[list[Ended], bytes]]:
        """Fly each rocket's first episode to its end, overwriting the group's last roll-out.

        :param begin: resets the world to starts with K copies each.
        :return: those episodes, step by step, and the snapshot after the last step.
        """
        flown: list[tuple[Tensor, Tensor, Tensor, Tensor]] = []
        finished: list[Ended] = []
        returns = np.zeros(self._returns.shape[1])
        last = np.zeros(len(returns), np.int64)
        flying = [np.ones(len(returns), np.bool_)]  # before each step

        def record(
            step: int, seen: Tensor, action: Tensor, log_prob: Tensor, results: Results,
        ) -> None:
            reward, _, _, info = results
            before = flying[step]
            rows = torch.from_numpy(np.flatnonzero(before))
            if len(rows):
                flown.append((seen[rows], action[rows], log_prob[rows], rows))
            returns[before] += reward[before]
            last[before] = step
            episodes: Episodes = info['episodes']
            first = episodes.take(before[episodes.row])
            if len(first):
                finished.append((step, first))
            after = before.copy()
            after[info['final_rows']] = False
            flying.append(after)

        observation = yield begin
        log_prob = torch.empty(_CHUNK, len(returns))
        step = 0
        # The results of a step are known when the next one has been taken (see `Act`). So the last
        # step is taken when all have landed already.
        while flying[max(step - 1, 0)].any():
            if step == 0 or (step % _CHUNK == 0 and not policy.noise_lasts):
                sample = policy.sampler(log_prob, generator)
            seen = torch.tensor(observation)
            action = sample(step % _CHUNK, seen)
            # Copied, because the sampler reuses the memory.
            observation = yield Act(action.numpy(), functools.partial(
                record, step, seen, action, log_prob[step % _CHUNK].clone()))
            step += 1
        self._flown[group], self._returns[group], self._last[group] = flown, returns, last
        return finished, (yield Snapshot())

    def batch(
        self, critic: Callable[[Tensor], Tensor], gamma: float, gae_lambda: float,
        reward_scale: float,
    ) -> Batch:
        """Return the samples, flattened, without targets; those of the early steps are left out.

        The parameters are those of `rollout_buffer.Rollout.batch`; critic, lambda and scale are
        not used.
        """
        advantage = torch.from_numpy(relative_advantages(
            self._returns.ravel(), self._copies, self.normalise_starts).astype(np.float32))
        first = 0
        parts = []
        for flown, last in zip(self._flown, torch.from_numpy(self._last), strict=True):
            for step, (*sample, rows) in enumerate(flown):
                weight = gamma ** (last[rows] - step).float()
                parts.append((*sample, advantage[rows + first] * weight, weight))
            first += self._returns.shape[1]
        *columns, weights = map(torch.cat, zip(*parts, strict=True))
        kept = weights >= _LEAST_WEIGHT
        if not kept.all():
            columns = [column[kept] for column in columns]
        observation, action, log_prob, advantages = columns
        nothing = torch.zeros_like(log_prob)
        return Batch(observation, action, log_prob, advantages, nothing, nothing)
