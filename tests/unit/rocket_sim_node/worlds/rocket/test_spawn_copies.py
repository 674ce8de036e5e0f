# SPDX-License-Identifier: Apache-2.0
"""Copies of a start: rockets that begin alike and differ only by their actions."""
from __future__ import annotations

import numpy as np
import pytest

from rocket_sim_node.worlds import make

COUNT, COPIES = 12, 4


def actions(seed: int, equal: bool) -> np.ndarray:
    """Return actions `(COUNT, 3)`, equal within the copies of a start, or not."""
    drawn = np.random.default_rng(seed).uniform(
        -1, 1, (COUNT // COPIES if equal else COUNT, 3))
    return np.repeat(drawn, COPIES if equal else 1, axis=0).astype(np.float32)


@pytest.mark.parametrize('world', ['rocket', 'rocket_planar'])
@pytest.mark.parametrize('conditions', ['nominal', 'harsh'])
def test_copies_with_equal_actions_get_equal_observations(world: str, conditions: str) -> None:
    env = make(world, COUNT, conditions=conditions, spawn_copies=COPIES, observation='extended')
    observation = env.reset(seed=3)
    for step in range(700):  # some episodes end, and others begin
        blocks = observation.reshape(COUNT // COPIES, COPIES, -1)
        assert (blocks == blocks[:, :1]).all(), step
        assert not np.array_equal(blocks[0, 0], blocks[1, 0])
        observation, *_ = env.step(actions(step, equal=True))


def test_copies_with_different_actions_begin_each_episode_alike() -> None:
    env = make('rocket', COUNT, spawn_copies=COPIES, conditions='mix')
    env.reset(seed=3)
    ended: dict[tuple[int, int], list[float]] = {}
    for step in range(900):
        observation, _, _, _, info = env.step(actions(step, equal=False))
        for row, episode in zip(info['final_rows'], info['episodes'].episode, strict=True):
            first = float(np.abs(observation[row]).sum())
            ended.setdefault((row // COPIES, episode), []).append(first)
    whole = [found for found in ended.values() if len(found) == COPIES]
    assert len(whole) >= 3
    for found in whole:
        assert found == [found[0]] * COPIES


def test_without_copies_all_begin_apart() -> None:
    env = make('rocket', COUNT)
    assert len(np.unique(env.reset(seed=3), axis=0)) == COUNT


def test_a_reset_may_ask_for_copies_and_a_snapshot_keeps_them() -> None:
    env = make('rocket', COUNT)
    env.reset(seed=3, spawn_copies=COPIES)
    for step in range(100):
        env.step(actions(step, equal=False))
    state = env.snapshot()
    other = make('rocket', COUNT)
    other.restore(state)
    for step in range(500):
        action = actions(step, equal=False)
        assert np.array_equal(env.step(action)[0], other.step(action)[0])
