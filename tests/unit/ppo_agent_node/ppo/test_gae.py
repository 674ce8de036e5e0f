# SPDX-License-Identifier: Apache-2.0
"""Generalised advantages against sums written out by hand."""
from __future__ import annotations

import pytest
import torch

from ppo_agent_node.ppo.gae import advantages_and_returns

GAMMA, LAMBDA = 0.9, 0.8
REWARD = [1.0, 2.0, 3.0, 4.0]
VALUE = [0.5, -1.0, 2.0, 0.25]
NEXT = [-1.0, 2.0, 0.25, 7.0]


def column(values: list[float]) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)[:, None]


def flags(*steps: int) -> torch.Tensor:
    return torch.tensor([[step in steps] for step in range(4)])


def advantages(
    terminated: torch.Tensor, truncated: torch.Tensor, following: list[float] = NEXT,
) -> list[float]:
    advantage, target = advantages_and_returns(
        column(REWARD), column(VALUE), column(following), terminated, truncated, GAMMA, LAMBDA)
    torch.testing.assert_close(target, advantage + column(VALUE))
    return [float(a) for a in advantage[:, 0]]


def by_hand(deltas: list[float], ends: tuple[int, ...]) -> list[float]:
    """The sum of equation 16, written as a sum rather than as a recursion."""
    result = []
    for start in range(4):
        total = 0.0
        for step in range(start, 4):
            total += (GAMMA * LAMBDA) ** (step - start) * deltas[step]
            if step in ends:
                break
        result.append(total)
    return result


def deltas(terminated: tuple[int, ...], following: list[float] = NEXT) -> list[float]:
    return [
        REWARD[t] + (0.0 if t in terminated else GAMMA * following[t]) - VALUE[t]
        for t in range(4)
    ]


def test_within_one_episode() -> None:
    assert advantages(flags(), flags()) == pytest.approx(by_hand(deltas(()), ()))


def test_termination_has_no_value_and_no_future() -> None:
    assert advantages(flags(1), flags()) == pytest.approx(by_hand(deltas((1,)), (1,)))


def test_truncation_is_bootstrapped_from_its_final_observation() -> None:
    following = [-1.0, 5.0, 0.25, 7.0]  # 5: of the final observation, not of the next episode
    found = advantages(flags(), flags(1), following)
    assert found == pytest.approx(by_hand(deltas((), following), (1,)))
    as_termination = advantages(flags(1), flags(), following)
    assert abs(found[0] - as_termination[0]) == pytest.approx(GAMMA * LAMBDA * GAMMA * 5.0)
    leaking = advantages(flags(), flags(), following)
    assert found[0] != pytest.approx(leaking[0])


def test_nothing_leaks_from_the_next_episode_or_another_rocket() -> None:
    reward, value = torch.rand(6, 2), torch.rand(6, 2)
    terminated = torch.zeros(6, 2, dtype=torch.bool)
    terminated[2, 0] = True
    truncated = torch.zeros_like(terminated)
    following = torch.rand(6, 2)
    arguments = (terminated, truncated, GAMMA, LAMBDA)
    before, _ = advantages_and_returns(reward, value, following, *arguments)
    reward[3:, 0] += 100
    following[2, 0] = float('nan')  # V after a termination is never read
    after, _ = advantages_and_returns(reward, value, following, *arguments)
    torch.testing.assert_close(after[:3, 0], before[:3, 0])
    torch.testing.assert_close(after[:, 1], before[:, 1])


def test_lambda_one_gives_returns_and_lambda_zero_the_one_step_error() -> None:
    reward, value, following = torch.rand(5, 3), torch.rand(5, 3), torch.rand(5, 3)
    following[:-1] = value[1:]
    none = torch.zeros(5, 3, dtype=torch.bool)
    _, target = advantages_and_returns(reward, value, following, none, none, 1.0, 1.0)
    torch.testing.assert_close(target[0], reward.sum(0) + following[-1])
    advantage, _ = advantages_and_returns(reward, value, following, none, none, 0.7, 0.0)
    torch.testing.assert_close(advantage, reward + 0.7 * following - value)
