# SPDX-License-Identifier: Apache-2.0
"""A vector environment as a `VecEnv` of stable-baselines3, which must be installed."""
from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from rocket_sim_node.gym import episode_info
from rocket_sim_node.gym.vector_env import HoverslamVectorEnv
from rocket_sim_node.worlds.base import F32

try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
except ModuleNotFoundError as _error:
    raise ImportError(
        'rocket_sim_node.gym.sb3 needs stable-baselines3: pip install stable-baselines3',
    ) from _error


class HoverslamVecEnv(VecEnv):
    """A `HoverslamVectorEnv` for stable-baselines3.

    >>> env = HoverslamVecEnv(gymnasium.make_vec('hoverslam/Rocket-v1', num_envs=256, level=7))
    >>> PPO('MlpPolicy', env).learn(1_000_000)

    The last step of an episode has in its `info` the entry `episode` (`r`, `l`), which stable-
    baselines3 logs, `terminal_observation`, `TimeLimit.truncated` and `episode_info.NAMES`.
    """

    def __init__(self, env: Any) -> None:
        """Use a vector environment, and close it with this one.

        :param env: from `gymnasium.make_vec`, with autoreset mode SAME_STEP; wrappers are allowed.
        :raises ValueError: for any other environment.
        """
        if not isinstance(getattr(env, 'unwrapped', None), HoverslamVectorEnv) or (
                env.metadata['autoreset_mode'] is not AutoresetMode.SAME_STEP):
            raise ValueError(
                f'env: got {env}, expected a HoverslamVectorEnv with autoreset_mode SAME_STEP')
        self.env = env
        self._actions: NDArray[Any] = np.zeros(0)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.metadata = {**env.metadata, **self.metadata}  # VecVideoRecorder reads render_fps

    def reset(self) -> F32:
        """Start new episodes, with the seed of `seed` and the options of `set_options`, once.

        They are used up even if they are refused.

        :raises ValueError: when the options are not the same for all environments.
        """
        seed, options = self._seeds[0], self._options
        self._reset_seeds()
        self._reset_options()
        if any(each != options[0] for each in options):
            raise ValueError(
                f'set_options: got {options}, expected the same for all environments')
        observation: F32
        observation, _ = self.env.reset(seed=seed, options=options[0])
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        return observation

    def step_async(self, actions: NDArray[Any]) -> None:
        """Take the actions of the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[F32, F32, NDArray[np.bool_], list[dict[str, Any]]]:
        """Advance all environments by one step."""
        observation, reward, terminated, truncated, info = self.env.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        done = terminated | truncated
        if 'final_info' in info:  # wrappers may add more at each step
            final = info['final_info']
            for row in np.flatnonzero(done).tolist():
                infos[row] = {
                    'terminal_observation': info['final_obs'][row],
                    'TimeLimit.truncated': bool(truncated[row] and not terminated[row])}
                if info['_final_info'][row]:  # False for episodes that a wrapper has cut short
                    figures = {name: final[name][row].item() for name in episode_info.NAMES}
                    infos[row] |= figures | {'episode': {
                        'r': figures['episode_return'], 'l': figures['episode_length']}}
        return observation, reward, done, infos

    def close(self) -> None:
        """Close the vector environment."""
        self.env.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return a picture of each environment."""
        return self.env.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the vector environment, once for each of the environments."""
        return [getattr(self._owner(attr_name), attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the vector environment.

        :raises ValueError: when it is not for all environments, which share it.
        """
        self._check_all(indices, attr_name)
        setattr(self._owner(attr_name), attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any,
    ) -> list[Any]:
        """Call a method of the vector environment once, and return its result for each.

        :raises ValueError: when it is not for all environments, which share it.
        """
        self._check_all(indices, method_name)
        result = getattr(self._owner(method_name), method_name)(*method_args, **method_kwargs)
        return [result for _ in self._get_indices(indices)]

    def _owner(self, name: str) -> Any:
        """Return the environment or the first wrapper that has an attribute; else the outermost.

        Gymnasium's wrappers pass on only the attributes of its own class.
        """
        env = self.env
        while not hasattr(env, name) and env is not env.unwrapped:
            env = env.env
        return env if hasattr(env, name) else self.env

    def _check_all(self, indices: Any, name: str) -> None:
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise ValueError(f'indices: got {indices!r}, expected None: all share {name!r}')

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Return for each environment whether the class is `Monitor`, or a base of it.

        They have no wrappers of their own, but their infos have the entry `episode` of a
        `Monitor`: `evaluate_policy` then takes returns from there, also inside `VecNormalize`.
        """
        chosen: Iterable[int] = self._get_indices(indices)
        return [issubclass(Monitor, wrapper_class) for _ in chosen]
