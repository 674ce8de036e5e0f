# SPDX-License-Identifier: Apache-2.0
"""Command `screenshot`: render an image of a recording without a screen."""
from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rocket_sim_node import command_line
from rocket_sim_node.recording.reader import RecordedTrajectory
from rocket_sim_node.recording.reader import trajectories
from rocket_sim_node.recording.render import render
from rocket_sim_node.recording.scene.blueprint import TABS
from rocket_sim_node.recording.sinks.rerun_program import ViewerError
from rocket_sim_node.recording.sinks.rewrite import tabs
from rocket_sim_node.settings import setting

BURN_HEIGHT = 26.0
BURN_PART = 0.3
"""`at:=burn` is at this height, m, above the end of the flight, or at this fraction of its
initial height, whichever is lower."""
MOMENTS = ('burn', 'touchdown', 'end')


@dataclass(frozen=True)
class ScreenshotSettings:
    """Arguments of the command."""

    recording: str = setting('', '', 'the .rrd file')
    output: str = setting('screenshot.png', '', 'the picture, .png')
    at: str = setting(
        'burn', '', "'burn' or 'touchdown' of the flight, 'end' of the recording, or seconds on "
        "the recording's sim_time")
    flight: int = setting(
        -1, '', 'number of the flight, from 0; -1: the last one that landed', -1, 1e9)
    tab: str = setting('flight', '', 'the tab in front', choices=TABS)
    width: int = setting(1600, 'px', 'width of the window', 640, 7680)
    height: int = setting(968, 'px', 'height of the window', 480, 4320)


def moment(picture: ScreenshotSettings, flights: list[RecordedTrajectory]) -> float:
    """Return the time of the image, s on the recording's `sim_time`.

    :raises ValueError: when there is no such flight or time.
    """
    if picture.at not in MOMENTS:
        try:
            seconds = float(picture.at)
        except ValueError:
            seconds = math.nan
        if not math.isfinite(seconds):
            raise ValueError(f'at: got {picture.at!r}, expected {", ".join(MOMENTS)} or seconds')
        return seconds
    if not flights:
        raise ValueError(f'recording: {picture.recording} holds no flights')
    if picture.flight >= len(flights):
        raise ValueError(f'flight: got {picture.flight}, expected 0 to {len(flights) - 1}')
    landed = [k for k, flight in enumerate(flights) if flight.outcome == 'landed']
    number = picture.flight if picture.flight >= 0 else (landed or [len(flights) - 1])[-1]
    flight = flights[number]
    if picture.at == 'end':
        ends = (one.start + float(one.time[-1]) + _settling(one) for one in flights)
        return max(ends) + 1.0
    if picture.at == 'touchdown':
        return flight.start + float(flight.time[-1]) + 1.0
    height = flight.position[:, 2] - flight.position[-1, 2]
    low = np.flatnonzero(
        (height < min(BURN_HEIGHT, BURN_PART * height[0])) & (flight.throttle > 0))
    return flight.start + float(flight.time[low[0] if low.size else len(flight.time) // 2])


def _settling(flight: RecordedTrajectory) -> float:
    """Return the duration of the motion after a flight, s."""
    return float(flight.summary.get('settled', 0) * flight.summary['dt'])


def take(picture: ScreenshotSettings) -> str:
    """Make an image; return the text to print.

    :raises ValueError: when there is no such flight, time or tab, or the picture's name does not
        end with .png.
    :raises OSError: when the recording cannot be read, or the image cannot be written.
    :raises ViewerError: when the viewer cannot show it.
    """
    if Path(picture.output).suffix.lower() != '.png':
        raise ValueError(f'output: got {picture.output!r}, expected a name that ends with .png')
    recording = Path(picture.recording)
    flights = trajectories(recording)
    if picture.tab != 'flight' and any(flight.pilot for flight in flights):
        raise ValueError(
            f'tab: got {picture.tab!r}, expected flight, as {recording} compares pilots')
    if picture.tab != 'flight' and picture.tab not in (there := tabs(recording)):
        raise ValueError(
            f'tab: got {picture.tab!r}, expected {", ".join(there)}, as {recording} has')
    # The timeline of a training counts iterations; the last one is shown.
    when = 2**31 if picture.tab == 'training' else moment(picture, flights)
    image, = render(recording, [when], size=(picture.width, picture.height), tab=picture.tab)
    Path(picture.output).parent.mkdir(parents=True, exist_ok=True)
    image.save(picture.output, optimize=True)
    return f'{picture.output}\n'


def main() -> None:
    """Run the command."""
    command_line.run(
        'screenshot', 'recording:=FILE [NAME:=VALUE ...]',
        'Renders a picture of a recording; needs no screen.', ScreenshotSettings, take,
        expected=(ViewerError,))


if __name__ == '__main__':
    main()
