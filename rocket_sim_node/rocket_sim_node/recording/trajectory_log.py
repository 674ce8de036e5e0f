# SPDX-License-Identifier: Apache-2.0
"""One flight on the timelines of a recording: a few `send_columns`, one per entity."""
from __future__ import annotations

import itertools
import json
from collections.abc import Sequence

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]  # it has no types
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing import palette
from rocket_sim_node.recording.drawing import plots
from rocket_sim_node.recording.drawing.palette import words
from rocket_sim_node.recording.drawing.plots import Plot
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.drawing.timepoint import pause_steps
from rocket_sim_node.recording.scene.camera import log_camera
from rocket_sim_node.recording.scene.conditions_log import drawn
from rocket_sim_node.recording.scene.conditions_log import log_conditions
from rocket_sim_node.recording.scene.conditions_log import unusual
from rocket_sim_node.recording.scene.effects import every
from rocket_sim_node.recording.scene.effects import to_body
from rocket_sim_node.recording.scene.sceneries import Scenery
from rocket_sim_node.recording.scene.sceneries import scenery
from rocket_sim_node.recording.trajectories.trajectory import Settling
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo

TRAIL_STEP = 20
PATH_POINTS = 40


def ending(flight: Trajectory, settling: Settling | None) -> str:
    """Return in a few words how a flight ended, and what became of the rocket."""
    end = words(flight.outcome or 'unfinished')
    return end if settling is None else f'{end}, {words(settling.verdict)}'


def describe(flight: Trajectory, stage: WorldInfo) -> str:
    """Return how a flight ended, in numbers."""
    fuel = f', {flight.fuel[0] - flight.fuel[-1]:.0f} kg of fuel' if stage.fuel > 0 else ''
    return (
        f'{flight.speed[-1]:.2f} m/s, {flight.tilt[-1]:.1f}°, '
        f'{flight.distance[-1]:.1f} m from the centre{fuel}, '
        f'{(len(flight) - 1) * stage.dt:.1f} s, return {flight.total_return:.1f}')


def log_flight(
    stream: rr.RecordingStream, flight: Trajectory, stage: WorldInfo, place: Timepoint,
    settling: Settling | None = None, look: Scenery | None = None,
) -> None:
    """Log a finished flight at its place, and what became of the rocket after its touchdown.

    :param look: what is logged and plotted, where that is not the scenery of the stage's world.
    :raises ValueError: when the settling's samples are not as wide as the flight's.
    """
    if settling is not None and settling.values.shape[1:] != flight.values.shape[1:]:
        raise ValueError(
            f'settling: samples are {settling.values.shape[1:]} wide, expected '
            f'{flight.values.shape[1:]}')
    look = look or scenery(stage.world)
    whole = flight.followed_by(settling)
    strange = unusual(flight.values, flight.layout, stage)
    recorded = (look.recorded, plots.UNUSUALS) if strange else (look.recorded,)
    _rocket(stream, whole, stage, place, look, recorded)
    log_camera(stream, whole, stage, place, look.camera)
    for effect in look.effects:
        effect(stream, whole, stage, place)
    if strange:
        log_conditions(stream, whole, stage, place)
    _trail(stream, whole, stage, place, look)
    _phases(stream, flight, settling, stage, place, look)
    _landing(stream, flight, settling, stage, place, look)


def _rocket(
    stream: rr.RecordingStream, flight: Trajectory, stage: WorldInfo, place: Timepoint,
    look: Scenery, recorded: Sequence[tuple[Plot, ...]],
) -> None:
    """Pose, arrows and plots: one row a step and one more, empty, to end the lines.

    :param recorded: what is plotted, by the kind of its records.
    """
    n = len(flight)
    rows = np.append(np.arange(n), n - 1)
    position, quaternion = flight.position[rows], flight.orientation[rows]
    count = 2 if look.thrust else 1
    arrows = np.zeros((n + 1, count, 3))
    arrows[:n, 0] = stage.unit * look.velocity * to_body(
        flight.orientation, flight.linear_velocity)
    if look.thrust:
        arrows[:n, 1, 2] = stage.unit * look.thrust * flight.throttle
    stream.send_columns(
        entities.ROCKET, place.times(np.append(np.arange(n), n), stage.dt), [
            *rr.Transform3D.columns(
                translation=position.astype(np.float32),
                quaternion=quaternion.astype(np.float32)),
            *rr.Arrows3D.columns(
                vectors=arrows.reshape(-1, 3).astype(np.float32)).partition([count] * (n + 1)),
            *(column for kind in recorded for column in plots.columns(kind, flight, stage)),
        ])


def _trail(
    stream: rr.RecordingStream, flight: Trajectory, stage: WorldInfo, place: Timepoint,
    look: Scenery,
) -> None:
    """Leave a line behind, blue where the rocket falls and amber where it burns."""
    end = every(TRAIL_STEP, len(flight))[1:]
    start = np.maximum(end - TRAIL_STEP, 0)
    rows = np.linspace(start, end, 2 + look.bends, axis=1).astype(np.int64)
    lines = flight.position[rows].astype(np.float32)
    colours = np.array((palette.FALL, palette.BURN), np.uint8)[
        (flight.throttle[end] > 0.0).astype(np.int64)]
    stream.send_columns(
        entities.TRAIL, place.times(end, stage.dt), rr.LineStrips3D.columns(
            strips=lines, colors=colours))


def phases(flight: Trajectory, shortest: int = 5) -> list[tuple[int, str]]:
    """Return (row, phase) where a phase begins: 'fall', 'burn' or 'settling', at last the outcome.

    It settles when it touches the ground with its engine off. The outcome of an unfinished flight
    is empty. A phase of less than `shortest` steps is left out: the throttle may chatter.
    """
    phase = np.where(flight.throttle > 0.0, 1, np.where(flight.touching, 2, 0))
    edges = np.flatnonzero(np.diff(phase)) + 1
    starts = [0, *edges.tolist(), len(flight) - 1]
    changes: list[tuple[int, str]] = []
    for start, end in itertools.pairwise(starts):
        name = ('fall', 'burn', palette.SETTLING)[phase[start]]
        if (end - start >= shortest or not changes) and (not changes or changes[-1][1] != name):
            changes.append((start, name))
    changes.append((len(flight) - 1, flight.outcome))
    return changes


def _phases(
    stream: rr.RecordingStream, flight: Trajectory, settling: Settling | None, stage: WorldInfo,
    place: Timepoint, look: Scenery,
) -> None:
    """Say in which phase the flight is, and above the rocket, until the next, how it ended."""
    changes = phases(flight)
    whole = flight.followed_by(settling)
    state = flight.outcome
    if settling is not None and len(settling.values):
        state = settling.verdict
        changes += [(len(flight), palette.SETTLING), (len(whole) - 1, state)]
    # Said again at the end of the pause, so that the recording does not end with the flight.
    changes.append((len(whole) + pause_steps(stage) - 2, state))
    text = (
        f'{ending(flight, settling)}\n'
        f'{flight.speed[-1]:.1f} m/s  {flight.tilt[-1]:.1f}°  {flight.distance[-1]:.1f} m')
    above = whole.position[-1] + whole.up[-1] * look.label * stage.unit
    shown = [0] * (len(changes) - 2) + [1, 1]
    stream.send_columns(
        entities.PHASE, place.times(np.array([row for row, _ in changes]), stage.dt), [
            *rr.StateChange.columns(state=[name for _, name in changes]),
            *rr.Points3D.columns(
                positions=[above] * 2, colors=[palette.light(_colour(flight, stage))] * 2,
                labels=[text] * 2).partition(shown),
        ])


def _colour(flight: Trajectory, stage: WorldInfo) -> palette.Colour:
    return palette.outcome_colours(stage.outcomes).get(flight.outcome, palette.GREY)


def touchdown(flight: Trajectory, stage: WorldInfo, reach: float = 1.0) -> NDArray[np.float64]:
    """Return where the end of a flight is marked: on the ground when it touched, `(3,)`.

    :param reach: how near to the ground the origin then is, in :attr:`WorldInfo.unit`.
    """
    mark: NDArray[np.float64] = flight.position[-1].copy()
    ground = 0.0
    if flight.layout.heights:
        half = stage.field_half_width
        terrain = flight.terrain[-1]
        ground = float(np.interp(mark[0], np.linspace(-half, half, len(terrain)), terrain))
    if mark[2] - ground <= reach * stage.touchdown_height:
        mark[2] = ground + 0.25 * stage.scale
    return mark


def _landing(
    stream: rr.RecordingStream, flight: Trajectory, settling: Settling | None, stage: WorldInfo,
    place: Timepoint, look: Scenery,
) -> None:
    """Leave the path for a while, a mark at its end for all time, and a line in the log."""
    last = len(flight) - 1
    colour = _colour(flight, stage)
    rows = np.unique(np.linspace(0, last, min(PATH_POINTS, last + 1)).astype(np.int64))
    text = (
        f'rocket {flight.row}, episode {flight.episode}: '
        f'{ending(flight, settling)}, {describe(flight, stage)}')
    times = place.times(np.array([last]), stage.dt)
    if place.iteration is not None:
        times.append(rr.TimeColumn('iteration', sequence=[place.iteration]))
    stream.send_columns(entities.PATHS, times, rr.LineStrips3D.columns(
        strips=[flight.position[rows].astype(np.float32)], colors=[(*colour, 110)]))
    stream.send_columns(
        entities.LANDINGS, times, [
            *rr.Points3D.columns(
                positions=[touchdown(flight, stage, look.reach)], colors=[colour]),
            *rr.TextLog.columns(
                text=[text], level=['INFO' if flight.outcome == stage.outcomes[0] else 'WARN']),
            *rr.DynamicArchetype.columns('Episode', components={
                'summary': _summary(flight, settling, stage, place, look)}),
        ])



def _summary(
    flight: Trajectory, settling: Settling | None, stage: WorldInfo, place: Timepoint,
    look: Scenery,
) -> pa.StructArray:
    """Return what there is to know of a flight beside its samples, as one record."""
    record = {
        'row': flight.row, 'episode': flight.episode, 'simulator_step': flight.step,
        'first_step': place.step, 'iteration': place.iteration or 0, 'samples': len(flight),
        'outcome': flight.outcome, 'return': flight.total_return,
        'speed': float(flight.speed[-1]), 'tilt': float(flight.tilt[-1]),
        'distance': float(flight.distance[-1]),
        'fuel_used': float(flight.fuel[0] - flight.fuel[-1]), 'tank': stage.fuel,
        'dt': stage.dt, 'arrow': look.velocity * stage.unit,
        'settled': 0 if settling is None else len(settling.values),
        'verdict': '' if settling is None else settling.verdict,
        'conditions': json.dumps(drawn(flight, stage)),
    }
    return pa.array([record])
