# SPDX-License-Identifier: Apache-2.0
"""A comparison: several pilots fly the same starts, and all are seen at the same time.

Each pilot has a copy of the scene below a path of its own, so that everything in it is logged by
the code that logs a single flight. Nothing here knows who the pilots are.
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
"""Not that of other recordings: the viewer keeps a layout for each application."""


@dataclass(frozen=True)
class Side:
    """What one pilot flew.

    `key` is its place among the entities, `name` what legends and tables call it, `title` stands
    above its view. Flight k of every side began like flight k of the others.
    """

    key: str
    name: str
    title: str
    flights: tuple[Trajectory, ...]


@dataclass(frozen=True)
class Logged:
    """What a comparison holds: its steps, and the results as Markdown."""

    steps: int
    text: str


class Below:
    """A stream that puts all entities below a path; what else a stream can do is not needed."""

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

    :raises ValueError: when there is none, two have one key, or they flew other starts.
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
    stream: rr.RecordingStream, sides: Sequence[Side], stage: WorldInfo, settle: Settle,
    heading: str = '', remarks: Sequence[str] = (),
) -> Logged:
    """Log flights of several pilots, each start for all of them at once.

    The next start follows when the slowest has ended, after a pause.

    :param settle: says what becomes of vehicles after their flights.
    :param heading: what is compared, in a line; `remarks` stand below the results.
    :raises ValueError: when the sides cannot be compared.
    """
    check(sides)
    steps, first, verdicts = 0, 0, []
    look = overlaid_plots.look(stage)
    for side in sides:
        look.static(_below(stream, side), stage)
        if any(unusual(flight.values, flight.layout, stage) for flight in side.flights):
            log_style(_below(stream, side), stage, plotted=False)
    overlaid_plots.log_styles(stream, sides)
    settled = [settle(side.flights, stage) for side in sides]
    for number, flights in enumerate(zip(*(side.flights for side in sides), strict=True)):
        longest, ends = 0, []
        for side, flight, settlings in zip(sides, flights, settled, strict=True):
            settling = settlings[number]
            log_flight(_below(stream, side), flight, stage, Timepoint(first), settling, look)
            length = len(flight.followed_by(settling))
            ends.append(settling.verdict if settling is not None else '')
            longest, steps = max(longest, length), steps + length
        verdicts.append(ends)
        first += longest + pause_steps(stage)
    text = results(sides, verdicts, stage, heading, remarks)
    stream.log(layout.RESULTS, rr.TextDocument(
        text, media_type=rr.MediaType.MARKDOWN), static=True)
    return Logged(steps, text)


def _below(stream: rr.RecordingStream, side: Side) -> rr.RecordingStream:
    return cast(rr.RecordingStream, Below(stream, f'/{side.key}'))


def write(
    path: Path, sides: Sequence[Side], stage: WorldInfo, settle: Settle, heading: str = '',
    remarks: Sequence[str] = (),
) -> Logged:
    """Write a comparison to a file, all of it or none.

    :param path: an old file there is replaced.
    :raises ValueError: when the sides cannot be compared.
    :raises OSError: naming the path.
    """
    check(sides)
    path.parent.mkdir(parents=True, exist_ok=True)
    raw, small = (path.with_name(f'.{path.stem}.{os.getpid()}.{part}.rrd') for part in 'ab')
    shown = layout.blueprint(sides, stage)
    try:
        raw.write_bytes(b'')  # the stream would not name what is wrong
        stream = rr.RecordingStream(APPLICATION)
        stream.set_log_time_enabled(False)
        stream.save(raw, default_blueprint=shown)
        with written(stream, raw):
            logged = log_comparison(stream, sides, stage, settle, heading, remarks)
        reader = RrdReader(raw)
        save(reader, joined(reader), small, shown)
        small.replace(path)
    except OSError as error:
        raise OSError(error.errno, f'could not write: {error.strerror}', str(path)) from error
    except RuntimeError as error:  # Rerun's
        raise OSError(5, f'could not write: {error}', str(path)) from error
    finally:
        raw.unlink(missing_ok=True)
        small.unlink(missing_ok=True)
    return logged
