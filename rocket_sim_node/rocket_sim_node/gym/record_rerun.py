# SPDX-License-Identifier: Apache-2.0
"""Recordings for Rerun of a vector environment in this process; Rerun must be installed."""
from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import VectorWrapper
from numpy.typing import NDArray

from rocket_sim_node import settings
from rocket_sim_node.gym.vector_env import HoverslamVectorEnv
from rocket_sim_node.gym.vector_env import Step
from rocket_sim_node.telemetry.capture import joined
from rocket_sim_node.worlds.base import F32

try:
    from rocket_sim_node.recording.recorder import Recorder
    from rocket_sim_node.recording.sinks.base import Sink
    from rocket_sim_node.recording.sinks.file_sink import FileSink
    from rocket_sim_node.recording.sinks.live_sink import LiveSink
    from rocket_sim_node.recording.trajectories import touchdown
    from rocket_sim_node.recording.trajectories.filter import RecordingFilter
    from rocket_sim_node.recording.trajectories.world_info import WorldInfo
except ModuleNotFoundError as _error:
    raise ImportError(
        f"rocket_sim_node.gym.record_rerun needs {_error.name}: "
        "pip install './rocket_sim_node[recording]'") from _error


class RecordRerun(VectorWrapper):
    """Records flights for Rerun, as the node `rerun_recorder` does.

    >>> envs = RecordRerun(gymnasium.make_vec('hoverslam/Rocket-v1', num_envs=256), 'flights.rrd')

    Call `close` at the end: until then the file has another name. A `reset` ends the flights in
    progress, which are not recorded.
    """

    def __init__(
        self, env: Any, output: str | Path = '', connect: str = '',
        rows: Iterable[int] = (0,), max_steps: int = 200_000,
    ) -> None:
        """Wrap a vector environment.

        :param env: from `gymnasium.make_vec`, without `simulators`; wrappers are allowed.
        :param output: file to write, .rrd; an existing file is never overwritten: the new one is
            numbered.
        :param connect: URL of a running viewer, such as `rerun+http://127.0.0.1:9876/proxy`.
        :param rows: numbers of the environments to record.
        :param max_steps: maximum number of steps recorded; about 100 KiB per 1 000.
        :raises TypeError: for a value of a wrong type.
        :raises ValueError: for another environment, no destination, or a value out of range.
        :raises OSError: when the file cannot be written.
        """
        super().__init__(env)
        unwrapped = env.unwrapped
        if not isinstance(unwrapped, HoverslamVectorEnv) or unwrapped.simulated is None:
            raise ValueError(
                f'env: got {env}, expected a HoverslamVectorEnv in this process; the node '
                'rerun_recorder records simulators')
        chosen = settings.build(
            RecordingFilter, {'rows': tuple(rows), 'max_steps': max_steps})
        if not chosen.rows or max(chosen.rows) >= env.num_envs:
            raise ValueError(
                f'rows: got {chosen.rows}, expected numbers from 0 to {env.num_envs - 1}')
        if not output and not connect:
            raise ValueError("output: got '', expected a file, or a URL in connect")
        sinks: list[Sink] = []
        if output:
            sinks.append(FileSink(Path(output).absolute(), _note))
        if connect:
            sinks.append(LiveSink(connect, _note))
        self._env, self._world = unwrapped, unwrapped.simulated
        self._rows = np.array(sorted(set(chosen.rows)))
        self._resets = self._step = 0
        self._recorder: Recorder | None = Recorder(
            chosen, sinks, _note, settle=touchdown.follow)
        spec = unwrapped.world_spec
        self._recorder.world(WorldInfo.build(
            spec.name, spec.dt, spec.outcomes, spec.settings, spec.condition_names))

    @property
    def flights(self) -> int:
        """Number of flights recorded so far; the last ones may still wait."""
        return 0 if self._recorder is None else self._recorder.flights

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None,
    ) -> tuple[F32, dict[str, Any]]:
        """Start new episodes; see `HoverslamVectorEnv.reset`."""
        found: tuple[F32, dict[str, Any]] = self.env.reset(seed=seed, options=options)
        self._record()
        return found

    def step(self, actions: NDArray[Any]) -> Step:
        """Advance all environments by one step; see `HoverslamVectorEnv.step`."""
        found: Step = self.env.step(actions)
        self._record()
        return found

    def _record(self) -> None:
        if self._recorder is None:
            return
        # A wrapper inside may have reset the environment within a step.
        begun = self._resets != self._env.resets
        self._resets, self._step = self._env.resets, 0 if begun else self._step + 1
        ended = self._world.finished
        ended = ended.take(np.flatnonzero(np.isin(ended.row, self._rows)))
        self._recorder.states(self._resets, joined([
            (self._step, ended), (self._step, self._world.telemetry(self._rows))]))
        self._recorder.tick()

    def close(self, **kwargs: Any) -> None:
        """Complete the recording, and close the environment."""
        recorder, self._recorder = self._recorder, None
        try:
            if recorder is not None:
                recorder.close()
        finally:
            super().close(**kwargs)


def _note(level: str, text: str) -> None:
    if level != 'INFO':
        gymnasium.logger.warn(text)
