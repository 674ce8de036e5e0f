# SPDX-License-Identifier: Apache-2.0
"""Execution of one goal: the processes of its command, and their result."""
from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from rocket_msgs.action import Evaluate
from rocket_msgs.action import Land
from rocket_msgs.action import Train
from rocket_msgs.msg import FlightFigures

from ppo_agent_node.nodes.actions.flight_figures import EpisodeStatistics
from ppo_agent_node.nodes.actions.flight_figures import read_figures
from ppo_agent_node.nodes.actions.goals import launch_file
from ppo_agent_node.nodes.actions.goals import start_of
from ppo_agent_node.nodes.actions.launch_process import LaunchProcess
from ppo_agent_node.runs.run_lock import UNFINISHED

KINDS = {'train': Train, 'evaluate': Evaluate, 'land': Land}
"""type of the action, by its name, which is that of the command"""
_FIGURES = 'evaluation.json'


class Execution:
    """The launch of a goal, from its start to its result."""

    def __init__(self, command: str, goal: Any, namespace: str, scratch: Path) -> None:
        """Check the goal and start its processes.

        :param command: name of the action.
        :param namespace: of the server.
        :param scratch: temporary folder, which must exist until the result is known.
        :raises ValueError: naming a field, what was given and what was expected.
        :raises TypeError: for a value of another kind.
        :raises OSError: when a file or folder cannot be read or made.
        """
        self.command = command
        self._start = start_of(command, goal, namespace, scratch)
        launch = self._start.launch
        self._place = Path(launch['run_dir' if command == 'train' else 'output'])
        self._before = _mark(self._place / _FIGURES)
        # An evaluation without `output` leaves no files; a training and a recording always stay.
        self._kept = command != 'evaluate' or bool(goal.output)
        self.statistics = EpisodeStatistics(
            getattr(goal, 'episodes', 0), getattr(goal, 'level', 0), command)
        self.process = LaunchProcess([
            'ros2', 'launch', str(launch_file(command)),
            *(f'{name}:={value}' for name, value in launch.items())], scratch / 'nodes.log')

    def result(self, stopped: str) -> Any:
        """Return the result, after the processes have ended; remove what was made for nothing.

        :param stopped: why they were asked to stop; empty: they were not.
        """
        kind = KINDS[self.command].Result
        failure = self.process.reason() if self.process.failed and not stopped else ''
        if self._done(bool(stopped or failure)):
            code, figures = kind.OK, self._figures()
            message = failure and f'the run is finished, but a process failed: {failure}'
        else:
            code, figures = kind.FAILED, self.statistics.figures()
            message = '; '.join(filter(None, (
                stopped or failure or 'ended without a result', self._advice())))
        self._tidy()
        where = str(self._place) if self._kept and self._place.exists() else ''
        return kind(code=code, message=message, figures=figures, **{
            'run_dir' if self.command == 'train' else 'output': where})

    def _done(self, ended_early: bool) -> bool:
        """Return whether the goal was reached."""
        if self.command == 'land':
            return self._place.is_file() and not ended_early
        written = _mark(self._place / _FIGURES) not in (None, self._before)
        if self.command == 'train':  # whatever else failed: its policy and figures are there
            return written and not (self._place / UNFINISHED).exists()
        return written and not ended_early

    def _figures(self) -> FlightFigures:
        if self.command == 'land':
            return self.statistics.figures()
        return read_figures(self._place / _FIGURES)

    def _advice(self) -> str:
        """Return how to continue a run."""
        if self.command != 'train':
            return ''
        if self._begun:
            return f'continue with the goal resume: true, run_dir: {self._place}'
        return 'the run had not begun: send the same goal again'

    @property
    def _begun(self) -> bool:
        """Whether there is a run; an agent writes its settings after it has checked everything."""
        return (self._place / 'config.yaml').exists()

    def _tidy(self) -> None:
        """Remove files and folders that the start created and left empty, as the commands do."""
        variables = self._start.script_variables
        if self.command == 'train' and not self._begun:
            if variables['made']:
                Path(str(variables['made'])).unlink(missing_ok=True)
            with suppress(OSError):  # there is something in it, or it was never made
                self._place.rmdir()
        partial = Path(str(variables.get('partial') or ''))
        if partial.is_file() and not partial.stat().st_size:
            partial.unlink()


def _mark(path: Path) -> tuple[int, int] | None:
    """Return a fingerprint that changes when a file is rewritten; None: there is no file."""
    try:
        about = path.stat()
    except OSError:
        return None
    return about.st_ino, about.st_mtime_ns
