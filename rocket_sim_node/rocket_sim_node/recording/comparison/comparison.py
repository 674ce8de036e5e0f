# SPDX-License-Identifier: Apache-2.0
"""Recording of a comparison: several pilots fly the same starts and are shown simultaneously.

Each pilot has a copy of the scene below its own entity path, so everything in it is logged by the
code for a single flight. The module does not depend on any particular pilot.
"""
from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from typing import cast

import numpy as np
import rerun as rr
from rerun.chunk import RrdReader

from rocket_sim_node.recording.comparison import layout as layout
from rocket_sim_node.recording.comparison import overlaid_plots
from rocket_sim_node.recording.comparison.table import results
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.drawing.timepoint import pause_steps
from rocket_sim_node.recording.scene.conditions_log import log_style
from rocket_sim_node.recording.scene.conditions_log import unusual
from rocket_sim_node.recording.sinks.rewrite import joined
from rocket_sim_node.recording.sinks.rewrite import save
from rocket_sim_node.recording.sinks.rrd_file import written
from rocket_sim_node.recording.timeline import Settle
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.recording.trajectory_log import log_flight

APPLICATION = 'hoverslam_comparison'
"""Differs from other recordings', because the viewer stores a layout per application."""


@dataclass(frozen=True)
class Side:
    """Flights of one pilot.

    `key` is its entity path, `name` its label in legends and tables, `title` the heading of its
    view. Flight k of every side has the same start.
    """

    key: str
    name: str
    title: str
    flights: tuple[Trajectory, ...]


@dataclass(frozen=True)
class Logged:
    """Content of a comparison: its number of steps, and the results as Markdown."""

    steps: int
    text: str


class Below:
    """A stream that logs below an entity path; has only the methods needed here."""

    def __init__(self, stream: rr.RecordingStream, path: str) -> None:
        """Log to `stream`, below `path`, such as '/expert'."""
        self._stream = stream
        self._path = path

    def log(self, entity: str, *what: Any, **how: Any) -> None:
        """Log as `RecordingStream.log` does."""
        self._stream.log(self._path + entity, *what, **how)

    def send_columns(self, entity: str, *what: Any, **how: Any) -> None:
        """Log as `RecordingStream.send_columns` does."""
        self._stream.send_columns(self._path + entity, *what, **how)


def check(sides: Sequence[Side]) -> None:
    """Check that sides can be compared.

    :raises ValueError: when there is none, two have the same key, or their starts differ.
    """
    if not sides or not sides[0].flights:
        raise ValueError('comparison: got no flights, expected one or more of each pilot')
    if len({side.key for side in sides}) < len(sides):
        raise ValueError(f'comparison: got {", ".join(s.key for s in sides)}, expected each once')
    first = sides[0]
    for side in sides:
        if len(side.flights) != len(first.flights):
            raise ValueError(
                f'comparison: {side.name} flew {len(side.flights)} flights, expected '
                f'{len(first.flights)} as {first.name} did')
        for number, (ours, theirs) in enumerate(zip(side.flights, first.flights, strict=True), 1):
            for quantity in ('position', 'orientation', 'linear_velocity', 'terrain'):
                if not np.array_equal(getattr(ours, quantity)[0], getattr(theirs, quantity)[0]):
                    raise ValueError(
                        f'comparison: flight {number} of {side.name} began at another {quantity} '
                        f'than that of {first.name}, expected equal starts')


def log_comparison(
    stream: rr.RecordingStream, sides: Sequence[Side], info: WorldInfo, settle: Settle,
    heading: str = '', remarks: Sequence[str] = (),
) -> Logged:
    """Log flights of several pilots, each start for all of them simultaneously.

    The next start follows after a pause when the slowest flight has ended.

    :param settle: returns the motion of vehicles after their flights.
    :param heading: one line on what is compared; `remarks` are added below the results.
    :raises ValueError: when the sides cannot be compared.
    """
    check(sides)
    steps, first, verdicts = 0, 0, []
    look = overlaid_plots.look(info)
    for side in sides:
        look.static(_below(stream, side), info)
        if any(unusual(flight.values, flight.layout, info) for flight in side.flights):
            log_style(_below(stream, side), info, plotted=False)
    overlaid_plots.log_styles(stream, sides)
    settled = [settle(side.flights, info) for side in sides]
    for number, flights in enumerate(zip(*(side.flights for side in sides), strict=True)):
        longest, ends = 0, []
        for side, flight, settlings in zip(sides, flights, settled, strict=True):
            settling = settlings[number]
            log_flight(_below(stream, side), flight, info, Timepoint(first), settling, look)
            length = len(flight.followed_by(settling))
            ends.append(settling.verdict if settling is not None else '')
            longest, steps = max(longest, length), steps + length
        verdicts.append(ends)
        first += longest + pause_steps(info)
    text = results(sides, verdicts, info, heading, remarks)
    stream.log(layout.RESULTS, rr.TextDocument(
        text, media_type=rr.MediaType.MARKDOWN), static=True)
    return Logged(steps, text)


def _below(stream: rr.RecordingStream, side: Side) -> rr.RecordingStream:
    return cast(rr.RecordingStream, Below(stream, f'/{side.key}'))


def write(
    path: Path, sides: Sequence[Side], info: WorldInfo, settle: Settle, heading: str = '',
    remarks: Sequence[str] = (),
) -> Logged:
    """Write a comparison to a file, completely or not at all.

    :param path: an existing file is replaced.
    :raises ValueError: when the sides cannot be compared.
    :raises OSError: naming the path.
    """
    check(sides)
    path.parent.mkdir(parents=True, exist_ok=True)
    raw, small = (path.with_name(f'.{path.stem}.{os.getpid()}.{part}.rrd') for part in 'ab')
    shown = layout.blueprint(sides, info)
    try:
        raw.write_bytes(b'')  # the stream's own error would not name the cause
        stream = rr.RecordingStream(APPLICATION)
        stream.set_log_time_enabled(False)
        stream.save(raw, default_blueprint=shown)
        with written(stream, raw):
            logged = log_comparison(stream, sides, info, settle, heading, remarks)
        reader = RrdReader(raw)
        save(reader, joined(reader), small, shown)
        small.replace(path)
    except OSError as error:
        raise OSError(error.errno, f'could not write: {error.strerror}', str(path)) from error
    except RuntimeError as error:  # raised by Rerun
        raise OSError(5, f'could not write: {error}', str(path)) from error
    finally:
        raw.unlink(missing_ok=True)
        small.unlink(missing_ok=True)
    return logged
