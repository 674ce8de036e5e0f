# SPDX-License-Identifier: Apache-2.0
"""A world as a vector environment of Gymnasium, in this process or over DDS."""
from __future__ import annotations

import copy
import importlib
from dataclasses import replace
from typing import Any
from typing import Protocol

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from rocket_sim_node import worlds
from rocket_sim_node.gym import episode_info
from rocket_sim_node.gym import keywords
from rocket_sim_node.gym import spaces
from rocket_sim_node.gym.rendering import Camera
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds import random_streams
from rocket_sim_node.worlds import snapshots
from rocket_sim_node.worlds.actions import idle_action
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.base import SimulatedWorld
from rocket_sim_node.worlds.registry import check_num_envs

Step = tuple[F32, F32, Bools, Bools, dict[str, Any]]
Frame = NDArray[np.uint8]
METADATA: dict[str, Any] = {
    'render_modes': list(keywords.RENDER_MODES), 'render_fps': 50,
    'autoreset_mode': AutoresetMode.SAME_STEP}
"""Metadata of the class; each instance has its own frames per second and mode."""
_STATE = 'world_state'
"""Name of the world's own snapshot in that of the environment."""


class _World(Protocol):
    """Interface that a world and simulators share; see `worlds.VectorEnv`."""

    @property
    def spec(self) -> WorldSpec: ...

    def reset(self, seed: int | None = None, **settings: Any) -> F32: ...

    def step(self, action: NDArray[Any]) -> Step: ...

    def snapshot(self) -> bytes: ...

    def restore(self, state: bytes) -> F32: ...


class HoverslamVectorEnv(gymnasium.vector.VectorEnv[F32, NDArray[Any], NDArray[Any]]):
    """N rockets as one vector environment; `gymnasium.make_vec` creates it.

    Observations are `(N, D)` float32, rewards `(N,)` float32, actions `(N, A)` float32 or `(N,)`
    whole numbers. Continuous actions beyond their bounds are clipped.

    With autoreset mode SAME_STEP, the default, an environment whose episode ends begins the next
    one in the same step. `info` then has `final_obs`, `final_info` and their masks `_final_obs`
    and `_final_info`; `final_info` has the statistics `episode_info.NAMES`, dense, `(N,)` each.

    With NEXT_STEP the step that ends an episode returns its last observation, and its statistics
    in `info` itself. The next step ignores the environment's action and returns reward 0 and an
    observation of the next episode. Since all rockets step together, that observation is one
    step after the start, with the engine off; neither return nor length of the episode count that
    step. (An episode that ends within it is not reported, and the next one's start is returned.)

    Each start is a function of (seed, row, number of the episode): equal seeds and actions give
    equal bits, in process and with one simulator over DDS.
    """

    metadata: dict[str, Any] = METADATA

    def __init__(
        self, world: str, num_envs: int = 1, *, seed: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        render_mode: str | None = None, simulators: str = '', patience: float = 60.0,
        step_threads: int = 1, **settings: Any,
    ) -> None:
        """Create the world, or connect to simulators.

        :param world: name of the world.
        :param num_envs: N; over DDS, of all simulators together.
        :param seed: seed of the first reset that has none of its own, 0 to 2**63 - 1; None: drawn
            by the operating system.
        :param autoreset_mode: SAME_STEP or NEXT_STEP.
        :param render_mode: `rgb_array` (in process only) or None.
        :param simulators: namespaces of the simulators to fly, such as `/sim_*`; empty: in this
            process. Simulator k, in the order of their names, is reset with seed + k.
        :param patience: seconds to wait for a simulator's answer.
        :param step_threads: threads that step the world, as `worlds.make` takes them; in process
            only, as simulators have a parameter of that name.
        :param settings: of the world, as `worlds.make` takes them. Over DDS, those that a reset
            can change are sent with each reset; start the simulators with the others.
        :raises TypeError: for a value of a wrong type.
        :raises ValueError: for an unknown keyword, or a value that is out of range.
        :raises ImportError: when `simulators` is given and ROS 2 is missing.
        :raises TimeoutError: when there are not enough simulators.
        """
        keywords.check_names(world, settings)
        keywords.check_connection(simulators, patience, step_threads)
        num_envs = check_num_envs(num_envs)
        seed = None if seed is None else random_streams.check_seed(seed)
        keywords.check_render_mode(render_mode, simulators)
        mode = keywords.autoreset_mode(autoreset_mode)
        self._world: _World | None = None
        self.simulated: SimulatedWorld | None = None
        """The world in this process; None over DDS, and after `close`."""
        self.reset_settings: dict[str, Any] = {}
        """Settings that each reset repeats; over DDS only."""
        if simulators:
            self._world = _over_dds(world, num_envs, simulators, patience)
            try:
                self.reset_settings = keywords.split_settings(
                    self._world.spec, settings, simulators)
            except BaseException:
                self.close_extras()
                raise
        else:
            self._world = self.simulated = worlds.make(
                world, num_envs, 0 if seed is None else seed, step_threads, **settings)
        spec = self._world.spec
        self.num_envs = spec.num_envs
        self.world_spec = spec
        """The shape of the world: columns, outcomes, constants."""
        self.render_mode = render_mode
        self.metadata = {
            **METADATA, 'render_fps': round(1 / spec.dt), 'autoreset_mode': mode}
        self.autoreset_mode = mode
        """As in `metadata`; TorchRL looks for it here, where Gymnasium's own vectors have it."""
        self.single_observation_space = spaces.observation_space(spec)
        self.single_action_space = spaces.action_space(spec)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._camera = None if render_mode is None else Camera(spec)
        self._same_step = mode is AutoresetMode.SAME_STEP
        self._seed = seed
        self._drawn: np.random.Generator | None = None
        """The `np_random` of the last reset."""
        self.resets = 0
        """Number of resets and restores so far."""
        self._idle = idle_action(spec)
        self._ended = np.zeros(self.num_envs, np.bool_)
        """With NEXT_STEP, which environments begin an episode at the next step."""
        self._skipped_reward = np.zeros(self.num_envs)
        self._skipped = np.zeros(self.num_envs, np.int64)
        """With NEXT_STEP, reward and steps of the current episodes that were not returned."""

    @property
    def reseeded(self) -> bool:
        """Whether the user has set another `np_random` since the last reset."""
        # Gymnasium gives generators of unknown seed the seed -1.
        return self.np_random_seed == -1 and self.np_random is not self._drawn

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None,
    ) -> tuple[F32, dict[str, Any]]:
        """Start new episodes of all environments; return observation `(N, D)` and no info.

        :param seed: of the starts, 0 to 2**63 - 1; None: the next episodes of the current seed, or
            of one drawn from `np_random`, if you have set another one since the last reset.
        :param options: settings that a reset may change, such as `level` and `conditions`
            (`worlds.reset_settings`), until the next reset.
        :raises ValueError: for an unknown option or a value that is out of range.
        """
        world = self._open()
        options = keywords.reset_options(options)
        seed = None if seed is None else random_streams.check_seed(seed)
        reseeded = self.reseeded
        if seed is None and not self.resets and not reseeded:
            seed = self._seed
        super().reset(seed=seed)
        if seed is None and (reseeded or not self.resets):
            seed = int(self.np_random.integers(2**62))
        observation = world.reset(seed, **{**self.reset_settings, **options})
        self._drawn = self.np_random
        self.resets += 1
        self._ended[:] = False
        self._skipped_reward[:] = self._skipped[:] = 0
        return observation, {}

    def step(self, actions: NDArray[Any]) -> Step:
        """Advance all environments by one step.

        :param actions: `(N, A)` numbers, or `(N,)` whole numbers.
        :return: observation, reward, terminated, truncated, info.
        :raises ValueError: for actions of a wrong shape or type, or that are not finite.
        :raises EnvironmentRestarted: when a simulator is in another session; call `reset`.
        """
        world = self._open()
        if not self.resets:
            raise gymnasium.error.ResetNeeded('step: call reset first')
        actions = keywords.actions(actions, self.action_space.shape)
        if not self._same_step:
            return self._step_next(world, actions)
        observation, reward, terminated, truncated, info = world.step(actions)
        found = {}
        if len(info['final_rows']):
            found = episode_info.final(
                info['episodes'], info['final_observation'], self.num_envs)
        return observation, reward, terminated, truncated, found

    def _step_next(self, world: _World, actions: NDArray[Any]) -> Step:
        """Advance all environments with autoreset mode NEXT_STEP."""
        begins = self._ended
        if begins.any() and actions.shape == self.action_space.shape:
            actions = np.where(
                begins.reshape(-1, *[1] * (actions.ndim - 1)), self._idle.astype(actions.dtype),
                actions)
        observation, reward, terminated, truncated, info = world.step(actions)
        # Rows whose episode ended within the step that is spent on the reset begin one more.
        rows = info['final_rows']
        again = begins & (terminated | truncated)
        self._skipped_reward[begins] = np.where(again, 0.0, reward)[begins]
        self._skipped[begins] = ~again[begins]
        reward[begins] = 0.0
        terminated[begins] = truncated[begins] = False
        reported = np.flatnonzero(~begins[rows])
        found: dict[str, Any] = {}
        self._ended = np.zeros(self.num_envs, np.bool_)
        if reported.size:
            episodes = info['episodes'].take(reported)
            row = episodes.row
            observation[row] = info['final_observation'][reported]
            found = episode_info.dense(replace(
                episodes, episode_return=episodes.episode_return - self._skipped_reward[row],
                length=episodes.length - self._skipped[row]), self.num_envs)
            self._ended[row] = True
            self._skipped_reward[row] = self._skipped[row] = 0
        return observation, reward, terminated, truncated, found

    def snapshot(self) -> bytes:
        """Return the exact state of all environments, for `restore`.

        Wrappers, such as `ReverseCurriculum`, have a state of their own, which is not in it.

        :raises ResetNeeded: before the first reset.
        """
        world = self._open()
        if not self.resets:
            raise gymnasium.error.ResetNeeded('snapshot: call reset first')
        state = np.frombuffer(world.snapshot(), np.uint8)
        return snapshots.pack(self.world_spec, {_STATE: state, **self._own_state()})

    def restore(self, state: bytes) -> F32:
        """Continue from a snapshot; return the observation `(N, D)`.

        The same actions then give the same bits as after the snapshot. It may have been taken in
        another process, in process or over one simulator, if the world was created with the same
        settings. `render` does not show episodes that had ended before the snapshot.

        :raises ValueError: when it is damaged, or of another world, settings, autoreset mode or
            number of environments.
        """
        world = self._open()
        own = self._own_state()
        arrays = snapshots.unpack(
            self.world_spec, state, {_STATE: np.zeros(0, np.uint8), **own}, (_STATE,))
        snapshots.check_counts(arrays, 'skipped_steps')
        if bool(arrays['same_step']) != self._same_step:
            raise ValueError(
                'snapshot: of the other autoreset mode, expected that of the environment, '
                f'{self.autoreset_mode.name}')
        observation = world.restore(arrays[_STATE].tobytes())
        for name, array in own.items():
            array[...] = arrays[name]
        self.resets += 1
        return observation

    def __deepcopy__(self, memo: dict[int, Any]) -> HoverslamVectorEnv:
        """Return a copy in the same state; not of a simulator, nor of a world with contacts.

        A copy by `snapshot` would change how the original continues, where contacts have a state
        that cannot be read, so the user must ask for it.

        :raises TypeError: when it cannot be copied; names what to use instead.
        """
        refusal = TypeError(
            f'deepcopy: an environment of {self.world_spec.name} cannot be copied; restore its '
            'snapshot in another one: other.unwrapped.restore(env.unwrapped.snapshot())')
        if self.simulated is None:
            raise refusal
        made = memo[id(self)] = object.__new__(type(self))
        try:
            made.__dict__.update(copy.deepcopy(self.__dict__, memo))
        except TypeError as error:
            raise refusal from error
        return made

    def _own_state(self) -> dict[str, NDArray[Any]]:
        """Return the autoreset mode, and the arrays of NEXT_STEP, which are not copies."""
        return {
            'same_step': np.array(self._same_step), 'ended': self._ended,
            'skipped_reward': self._skipped_reward, 'skipped_steps': self._skipped}

    def render(self) -> tuple[Frame, ...] | None:
        """Return a picture of each environment, `(height, width, 3)` uint8; None without a mode.

        With NEXT_STEP, an environment whose episode has ended is shown at its end.
        """
        self._open()
        if self._camera is None or self.simulated is None:
            return None
        states = self.simulated.telemetry(slice(None))
        frames = [self._camera.frame(states, index) for index in range(self.num_envs)]
        if self._ended.any():
            ends = self.simulated.finished
            for index, row in enumerate(ends.row.tolist()):
                if self._ended[row]:
                    frames[row] = self._camera.frame(ends, index)
        return tuple(frames)

    def render_end(self) -> Frame | None:
        """Return a picture of the first environment at the end of its last episode.

        It must have ended at the last step; after a `restore`, the next one's start is shown.
        """
        self._open()
        if self._camera is None or self.simulated is None:
            return None
        ends = self.simulated.finished
        return self._camera.frame(
            ends if len(ends.row) else self.simulated.telemetry(slice(None)), 0)

    def close_extras(self, **_: Any) -> None:
        """Free the world, or release the simulators; `close` calls this once."""
        world, self._world, self.simulated = self._world, None, None
        close = getattr(world, 'close', None)
        if close is not None:
            close()

    def _open(self) -> _World:
        if self._world is None:
            raise gymnasium.error.ClosedEnvironmentError('the environment is closed')
        return self._world


def _over_dds(world: str, num_envs: int, simulators: str, patience: float) -> Any:
    """Return the simulators as a world.

    :raises ImportError: when ROS 2 is missing.
    """
    try:
        # By name, as this module is imported without ROS 2 too.
        over_dds = importlib.import_module('rocket_sim_node.gym.over_dds')
    except ModuleNotFoundError as error:
        raise ImportError(
            f'simulators: got {simulators!r}, expected nothing without ROS 2: '
            f'module {error.name!r} is missing') from error
    return over_dds.Simulators(world, num_envs, simulators, patience)
