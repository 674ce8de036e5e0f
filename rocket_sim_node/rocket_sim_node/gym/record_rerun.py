# SPDX-License-Identifier: Apache-2.0
"""Recordings for Rerun of a vector environment in this process; Rerun must be installed."""
from __future__ import annotations

import weakref
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import VectorWrapper
from numpy.typing import NDArray

from rocket_sim_node import settings
from rocket_sim_node.gym.curriculum import ReverseCurriculum
from rocket_sim_node.gym.vector_env import HoverslamVectorEnv
from rocket_sim_node.gym.vector_env import Step
from rocket_sim_node.telemetry.capture import joined
from rocket_sim_node.worlds.base import F32

try:
    from rocket_sim_node.recording.recorder import Recorder
    from rocket_sim_node.recording.sinks.base import Sink
    from rocket_sim_node.recording.sinks.destinations import check_suffix
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

    The file gets its name at `close`, or when the program ends without it. A `reset` or a
    `restore` ends the flights in progress, which are not recorded, and flights are recorded from
    their start only. To record a reverse curriculum, wrap this in a `ReverseCurriculum`.
    """

    def __init__(
        self, env: Any, output: str | Path = '', connect: str = '',
        rows: Iterable[int] = (0,), max_steps: int = 200_000,
    ) -> None:
        """Wrap a vector environment.

        :param env: from `gymnasium.make_vec`, without `simulators`; wrappers are allowed, except
            `ReverseCurriculum`.
        :param output: file to write, .rrd; an existing file is never overwritten: the new one is
            numbered, `-2`.
        :param connect: URL of a running viewer, such as `rerun+http://127.0.0.1:9876/proxy`.
        :param rows: numbers of the environments to record.
        :param max_steps: maximum number of steps recorded; about 100 KiB per 1 000.
        :raises TypeError: for a value of a wrong type.
        :raises ValueError: for another environment, no destination, or a value out of range.
        :raises OSError: when the file cannot be written.
        """
        unwrapped = getattr(env, 'unwrapped', None)
        if not isinstance(unwrapped, HoverslamVectorEnv) or unwrapped.simulated is None:
            raise ValueError(
                f'env: got {env}, expected a HoverslamVectorEnv in this process; the node '
                'rerun_recorder records simulators')
        inner = env
        while inner is not unwrapped:
            if isinstance(inner, ReverseCurriculum):  # its resets would hide the last landings
                raise ValueError(
                    f'env: got {env}, expected no ReverseCurriculum inside, but around')
            inner = inner.env
        super().__init__(env)
        if not isinstance(rows, Iterable):
            raise TypeError(f'rows: got {rows!r}, expected a list of whole numbers')
        chosen = settings.build(
            RecordingFilter, {'rows': tuple(rows), 'max_steps': max_steps})
        if not chosen.rows or max(chosen.rows) >= env.num_envs:
            raise ValueError(
                f'rows: got {chosen.rows}, expected numbers from 0 to {env.num_envs - 1}')
        if not isinstance(output, str | Path | None):
            raise TypeError(f'output: got {output!r:.80}, expected the name of a file')
        if not isinstance(connect, str | None):
            raise TypeError(f'connect: got {connect!r:.80}, expected a URL')
        if not output and not connect:
            raise ValueError("output: got '', expected a file, or a URL in connect")
        if output:
            check_suffix(output)
        self._file: FileSink | None = None
        with ExitStack() as opened:
            sinks: list[Sink] = []
            if connect:
                sinks.append(LiveSink(connect, _note))
                opened.callback(sinks[-1].close)
            if output:
                self._file = FileSink(Path(output).absolute(), _note)
                sinks.append(self._file)
            opened.pop_all()  # the recorder closes them
        self._env, self._world = unwrapped, unwrapped.simulated
        self._rows = np.array(sorted(set(chosen.rows)))
        self._resets = self._step = 0
        self._recorder = Recorder(chosen, sinks, _note, settle=touchdown.follow)
        self._recorder.world(WorldInfo.of(unwrapped.world_spec))
        self._finish = weakref.finalize(self, self._recorder.close)

    @property
    def flights(self) -> int:
        """Number of flights recorded so far; until `close`, the last ones may still wait."""
        return self._recorder.flights

    @property
    def path(self) -> Path | None:
        """The file written, which is numbered if its name was taken; None until `close`.

        It remains None if nothing was recorded, or without `output`.
        """
        return None if self._file is None else self._file.published

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
        if not self._finish.alive:  # closed
            return
        begun = self._resets != self._env.resets
        self._resets, self._step = self._env.resets, 0 if begun else self._step + 1
        ended = self._world.finished
        ended = ended.take(np.flatnonzero(np.isin(ended.row, self._rows)))
        self._recorder.states(self._resets, joined([
            (self._step, ended), (self._step, self._world.telemetry(self._rows))]))
        self._recorder.tick()

    def close(self, **kwargs: Any) -> None:
        """Complete the recording, and close the environment."""
        try:
            self._finish()  # does nothing the second time
        finally:
            super().close(**kwargs)


def _note(level: str, text: str) -> None:
    if level != 'INFO':
        gymnasium.logger.warn('%s', text)  # the text may have a %
