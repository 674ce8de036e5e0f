# SPDX-License-Identifier: Apache-2.0
"""A small world for tests that is quick to learn, with discrete actions, no levels and no fuel."""
from __future__ import annotations

from typing import Any

import numpy as np

from rocket_sim_node.worlds.base import NO_EPISODES
from rocket_sim_node.worlds.base import Episodes
from rocket_sim_node.worlds.base import WorldSpec

NOTHING, LEFT, RIGHT, FAULT = range(4)
OUTCOMES = ('landed', 'crashed', 'out_of_bounds', 'timeout')
_REACH, _LIMIT = 8, 20


class LineWorld:
    """Each lander stands on an integer and has to walk to 0, one step left or right at a time.

    At 0 it has landed (+10), beyond 8 it is out of bounds (-10), and after 20 steps the episode is
    truncated. A step costs 0.1; the action `fault` crashes at once (-20). The start of an episode
    is a pure function of (seed, row, episode), as in the real worlds.
    """

    def __init__(self, num_envs: int = 8, seed: int = 0) -> None:
        self.spec = WorldSpec(
            name='line', num_envs=num_envs, dt=0.02, observation_names=('place', 'age'),
            action_names=('walk',), continuous=False, action_low=(), action_high=(),
            action_idle=(0.0,), action_count=4, outcomes=OUTCOMES, settings={'gravity': 1.0})
        self.rows = np.arange(num_envs)
        self.reset(seed)

    def reset(self, seed: int | None = None, **settings: float) -> np.ndarray:
        if settings:
            raise ValueError(f'reset: unknown setting {sorted(settings)}, expected none')
        if seed is not None:
            self.seed, self.episode = seed, np.zeros_like(self.rows)
        else:
            self.episode = self.episode + 1
        self.place, self.age = self._starts(self.rows), np.zeros_like(self.rows)
        self.total = np.zeros(len(self.rows))
        return self._observe()

    def _starts(self, rows: np.ndarray) -> np.ndarray:
        return np.array([
            np.random.default_rng((self.seed, row, self.episode[row])).choice([-3, -2, 2, 3])
            for row in rows.tolist()])

    def _observe(self) -> np.ndarray:
        return np.stack((self.place / 3, self.age / _LIMIT), axis=1).astype(np.float32)

    def step(self, action: np.ndarray) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        assert action.dtype.kind == 'i', action.dtype
        assert action.shape == self.rows.shape, action.shape
        self.place = self.place + (action == RIGHT) - (action == LEFT)
        self.age = self.age + 1
        crashed, landed = action == FAULT, (self.place == 0) & (action != FAULT)
        outside = (np.abs(self.place) > _REACH) & ~crashed
        reward = -0.1 + 10.0 * landed - 10.0 * outside - 20.0 * crashed
        self.total = self.total + reward
        terminated = landed | outside | crashed
        truncated = (self.age >= _LIMIT) & ~terminated
        done = np.flatnonzero(terminated | truncated)
        observation = self._observe()
        info: dict[str, Any] = {
            'final_rows': done, 'final_observation': observation[done], 'episodes': NO_EPISODES}
        if done.size:
            outcome = np.select([landed, crashed, outside], [0, 1, 2], 3)[done].astype(np.uint8)
            zeros = np.zeros(len(done))
            info['episodes'] = Episodes(
                done, self.episode[done], self.total[done], self.age[done], outcome, zeros,
                zeros, np.abs(self.place[done]).astype(float), zeros, zeros, zeros,
                np.zeros(len(done), np.int64), zeros)
            self.episode[done] += 1
            self.place[done], self.age[done], self.total[done] = self._starts(done), 0, 0.0
            observation = self._observe()
        return observation, reward.astype(np.float32), terminated, truncated, info

    def snapshot(self) -> bytes:
        return np.stack((
            self.place, self.age, self.episode, self.total,
        )).astype(np.float64).tobytes() + int(self.seed).to_bytes(8, 'little')

    def restore(self, state: bytes) -> np.ndarray:
        if len(state) != (4 * len(self.rows) + 1) * 8:
            raise ValueError('snapshot: of another size')
        array = np.frombuffer(state[:-8]).reshape(4, -1).copy()
        self.place, self.age, self.episode = array[:3].astype(np.int64)
        self.total, self.seed = array[3], int.from_bytes(state[-8:], 'little')
        return self._observe()


def walker(observation: np.ndarray) -> np.ndarray:
    """Return the optimal actions, which walk to 0."""
    return np.where(observation[:, 0] > 0, LEFT, RIGHT).astype(np.int32)
