# SPDX-License-Identifier: Apache-2.0
"""One rocket as an environment of Gymnasium."""
from __future__ import annotations

import json
from numbers import Real
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.gym import keywords
from rocket_sim_node.gym.vector_env import Frame
from rocket_sim_node.gym.vector_env import HoverslamVectorEnv
from rocket_sim_node.settings import as_float
from rocket_sim_node.worlds import random_streams
from rocket_sim_node.worlds import snapshots
from rocket_sim_node.worlds.actions import check_form
from rocket_sim_node.worlds.base import F32

METADATA: dict[str, Any] = {'render_modes': list(keywords.RENDER_MODES), 'render_fps': 50}


class HoverslamEnv(gymnasium.Env[F32, Any]):
    """One rocket; `gymnasium.make` creates it.

    Observations are `(D,)` float32, actions `(A,)` float32 or a whole number. The last step's
    `info` has the statistics `episode_info.NAMES`. A `reset` without a seed begins the next
    episode of the current one, so equal seeds give the episodes of the first environment of a
    :class:`HoverslamVectorEnv`. Vector environments of many rockets are tens to hundreds of times
    as fast.
    """

    metadata: dict[str, Any] = METADATA

    def __init__(
        self, world: str, *, seed: int | None = None, render_mode: str | None = None,
        simulators: str = '', patience: float = 60.0, **settings: Any,
    ) -> None:
        """Create the world, or connect to a simulator that has one rocket.

        :param world: name of the world. The other parameters are those of
            :class:`HoverslamVectorEnv`.
        :raises TypeError: for a value of a wrong type.
        :raises ValueError: for an unknown keyword, or a value that is out of range.
        """
        keywords.check_names(world, settings, keywords.OWN_SINGLE)
        self._envs = HoverslamVectorEnv(
            world, 1, seed=seed, render_mode=render_mode, simulators=simulators,
            patience=patience, **settings)
        self.world_spec = self._envs.world_spec
        """The shape of the world: columns, outcomes, constants."""
        self.render_mode = render_mode
        self.metadata = {**METADATA, 'render_fps': self._envs.metadata['render_fps']}
        self.observation_space = self._envs.single_observation_space
        self.action_space = self._envs.single_action_space
        self._next: NDArray[np.float32] | None = None
        """First observation of the episode that follows the one that has just ended."""
        self._options = _text({})
        """Options of the current episode."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None,
    ) -> tuple[F32, dict[str, Any]]:
        """Start an episode; see `HoverslamVectorEnv.reset`."""
        options = keywords.reset_options(options)
        seed = None if seed is None else random_streams.check_seed(seed)
        super().reset(seed=seed)
        if self.np_random_seed == -1:  # the user has set `np_random`
            self._envs.np_random = self.np_random
        first, text = self._next, _text(options)
        if (first is None or seed is not None or text != self._options
                or self._envs.reseeded):
            observation, _ = self._envs.reset(seed=seed, options=options)
            first = observation[0]
            self._np_random, self._np_random_seed = (
                self._envs.np_random, self._envs.np_random_seed)
        self._next, self._options = None, text  # not when the reset has been refused
        return first, {}

    def step(self, action: Any) -> tuple[F32, float, bool, bool, dict[str, Any]]:
        """Advance by one step; see `HoverslamVectorEnv.step`."""
        if self._next is not None:
            raise gymnasium.error.ResetNeeded('step: the episode has ended, expected a reset')
        shape = self.action_space.shape or ()
        action = keywords.actions(action, shape)
        # The world would name the shapes of a batch of one.
        check_form(action, shape, continuous=self.world_spec.continuous)
        observation, reward, terminated, truncated, info = self._envs.step(action[None])
        last = observation[0]
        found = {}
        if info:
            self._next, last = last, info['final_obs'][0]
            found = {
                name: values[0].item() for name, values in info['final_info'].items()
                if not name.startswith('_')}
        return last, float(reward[0]), bool(terminated[0]), bool(truncated[0]), found

    def snapshot(self) -> bytes:
        """Return the exact state of the environment; see `HoverslamVectorEnv.snapshot`."""
        following = np.zeros(0, np.float32) if self._next is None else self._next
        return snapshots.pack(self.world_spec, {
            'state': np.frombuffer(self._envs.snapshot(), np.uint8), 'next': following,
            'options': np.frombuffer(self._options.encode(), np.uint8)})

    def restore(self, state: bytes) -> F32:
        """Continue from a snapshot; see `HoverslamVectorEnv.restore`.

        :return: the observation `(D,)`; of the next episode, if the snapshot was taken at the end
            of one, in which case a reset must follow.
        """
        like: snapshots.Arrays = {
            'state': np.zeros(0, np.uint8), 'next': np.zeros(0, np.float32),
            'options': np.zeros(0, np.uint8)}
        arrays = snapshots.unpack(self.world_spec, state, like, tuple(like))
        following = arrays['next']
        if len(following) not in (0, self.world_spec.observation_size):
            raise ValueError(f'snapshot: next is of length {len(following)}')
        observation: F32 = self._envs.restore(arrays['state'].tobytes())[0]
        self._next = following if len(following) else None
        self._options = arrays['options'].tobytes().decode(errors='replace')
        return observation

    def render(self) -> Frame | None:
        """Return a picture `(height, width, 3)` uint8; None without `render_mode`."""
        if self._next is not None:
            return self._envs.render_end()
        frames = self._envs.render()
        return None if frames is None else frames[0]

    def close(self) -> None:
        """Free the world, or release the simulator; may be called again."""
        self._next = None  # a reset would return it
        self._envs.close()


def _is_number(value: object) -> bool:
    """Return whether a value is a number; True would equal 1, and is refused as a number."""
    return isinstance(value, Real) and not isinstance(value, bool)


def _text(options: dict[str, Any]) -> str:
    """Return options as a text that is equal for equal options, and that a snapshot can hold."""
    same = {name: as_float(value) if _is_number(value) else value
            for name, value in options.items()}
    return json.dumps(same, sort_keys=True, default=repr)
