# SPDX-License-Identifier: Apache-2.0
"""The reverse curriculum for learners of other libraries."""
from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector import VectorWrapper
from numpy.typing import NDArray

from rocket_sim_node import worlds
from rocket_sim_node.gym import keywords
from rocket_sim_node.gym.vector_env import HoverslamVectorEnv
from rocket_sim_node.gym.vector_env import Step
from rocket_sim_node.settings import as_float
from rocket_sim_node.settings import whole_number
from rocket_sim_node.worlds.base import F32

_LARGEST_WINDOW = 10**9


class ReverseCurriculum(VectorWrapper):
    """Lets episodes begin near the ground, and ever higher as they land.

    >>> envs = ReverseCurriculum(gymnasium.make_vec('hoverslam/Rocket-v1', num_envs=256))

    Florensa et al., 'Reverse curriculum generation for reinforcement learning', 2017: if the
    reward comes only at the end of a flight, the end is learnt first. Starts are uniform in height
    up to `reach` above touchdown (setting `spawn_reach`). When enough of the last episodes have
    landed, the reach grows and all environments begin a new episode: those that were in flight
    are truncated, with a last observation in `final_obs` and no entry in `final_info`. After the
    full reach, episodes have the ordinary starts.
    """

    def __init__(
        self, env: Any, reach: float = 0.4, growth: float = 1.25, landing_rate: float = 0.95,
        window: int = 1000,
    ) -> None:
        """Wrap a vector environment.

        :param env: from `gymnasium.make_vec`, with autoreset mode SAME_STEP; it may be
            wrapped in a `RecordRerun`.
        :param reach: m, first maximum of the start height above touchdown.
        :param growth: factor by which the reach grows.
        :param landing_rate: fraction of the window's episodes that must land.
        :param window: number of episodes.
        :raises TypeError: for a value of a wrong type.
        :raises ValueError: for another environment, for one with a `spawn_reach` of its own, or
            for a value out of range.
        """
        unwrapped = getattr(env, 'unwrapped', None)
        if not isinstance(unwrapped, HoverslamVectorEnv) or (
                env.metadata['autoreset_mode'] is not AutoresetMode.SAME_STEP):
            raise ValueError(
                f'env: got {env}, expected a HoverslamVectorEnv with autoreset_mode SAME_STEP')
        spec = unwrapped.world_spec
        if 'spawn_reach' not in worlds.reset_settings(spec.name):
            raise ValueError(f'env: got world {spec.name}, expected one with setting spawn_reach')
        _refuse_reach({**spec.settings, **unwrapped.reset_settings})
        for name, value in (('reach', reach), ('growth', growth), ('landing_rate', landing_rate)):
            keywords.check_number(name, value)
        self._hoverslam = unwrapped
        full = self._full_reach({})
        if not 0 < reach <= full:
            raise ValueError(f'reach: got {reach}, expected more than 0, to {full:g} m')
        if not growth > 1:
            raise ValueError(f'growth: got {growth}, expected more than 1')
        if not 0 <= landing_rate <= 1:
            raise ValueError(f'landing_rate: got {landing_rate}, expected 0 to 1')
        window = whole_number('window', window, 1, _LARGEST_WINDOW)
        super().__init__(env)
        self.autoreset_mode = unwrapped.autoreset_mode
        self.reach = reach
        """m, maximum height of a start above touchdown."""
        self.over = False
        """Whether episodes have the ordinary starts."""
        self._full, self._growth, self._needed = full, as_float(growth), landing_rate
        self._landed: deque[bool] = deque(maxlen=window)
        self._options: dict[str, Any] = {}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None,
    ) -> tuple[F32, dict[str, Any]]:
        """Start new episodes below the current reach; see `HoverslamVectorEnv.reset`.

        A reach beyond the full drop that the options give becomes that drop.

        :raises ValueError: for an option `spawn_reach`, which the curriculum sets.
        """
        options = keywords.reset_options(options)
        _refuse_reach(options)
        full = self._full_reach(options)
        reach = min(self.reach, full) if full > 0 else self.reach  # else the reset is refused
        found = self._begin(seed, reach, options)
        self._options, self._full, self.reach = options, full, reach
        self._landed.clear()
        return found

    def step(self, actions: NDArray[Any]) -> Step:
        """Advance all environments by one step; the reach may grow after it."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        if not self.over and 'final_info' in info:  # wrappers may add more at each step
            final = info['final_info']
            self._landed.extend(final['is_success'][info['_final_info']].tolist())
            if len(self._landed) == self._landed.maxlen and (
                    np.mean(self._landed) >= self._needed):
                flying = np.flatnonzero(~(terminated | truncated))
                for row in flying.tolist():
                    info['final_obs'][row] = observation[row].copy()
                info['_final_obs'][flying] = truncated[flying] = True
                self.over = self.reach == self._full
                self.reach = min(self._growth * self.reach, self._full)
                self._landed.clear()
                observation, _ = self._begin(None, self.reach, self._options)
        return observation, reward, terminated, truncated, info

    def _begin(
        self, seed: int | None, reach: float, options: Mapping[str, Any],
    ) -> tuple[F32, dict[str, Any]]:
        found: tuple[F32, dict[str, Any]] = self.env.reset(
            seed=seed, options={**options, 'spawn_reach': 0.0 if self.over else reach})
        return found

    def _full_reach(self, options: Mapping[str, Any]) -> float:
        """Return the full drop after a reset with these options, m."""
        given = {**self._hoverslam.reset_settings, **options}
        # The world refuses what is no number.
        numbers = {
            name: as_float(value) for name, value in given.items() if isinstance(value, Real)}
        return worlds.full_reach(self._hoverslam.world_spec.after_reset(numbers))


def _refuse_reach(settings: Mapping[str, Any]) -> None:
    """Check that nobody else sets the reach.

    :raises ValueError: for a `spawn_reach` that is not 0.
    """
    given = settings.get('spawn_reach', 0)
    if not isinstance(given, Real) or given != 0:
        raise ValueError(
            f'spawn_reach: got {given!r:.80}, expected none: the curriculum sets it (reach)')
