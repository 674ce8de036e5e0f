# SPDX-License-Identifier: Apache-2.0
"""Logging of one flight: a few `send_columns`, one per entity."""
from __future__ import annotations

import itertools
import json
from collections.abc import Sequence

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]  # it has no types
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node import palette
from rocket_sim_node.frames import to_body
from rocket_sim_node.palette import words
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing import plots
from rocket_sim_node.recording.drawing.plots import Plot
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.drawing.timepoint import pause_steps
from rocket_sim_node.recording.scene.camera import log_camera
from rocket_sim_node.recording.scene.conditions_log import drawn
from rocket_sim_node.recording.scene.conditions_log import log_conditions
from rocket_sim_node.recording.scene.conditions_log import unusual
from rocket_sim_node.recording.scene.effects import every
from rocket_sim_node.recording.scene.sceneries import Scenery
from rocket_sim_node.recording.scene.sceneries import scenery
from rocket_sim_node.recording.trajectories.trajectory import Settling
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo

TRAIL_STEP = 20
PATH_POINTS = 40


def ending(flight: Trajectory, settling: Settling | None) -> str:
    """Return a short text on how a flight ended, and on the rocket afterwards."""
    end = words(flight.outcome or 'unfinished')
    return end if settling is None else f'{end}, {words(settling.verdict)}'


def describe(flight: Trajectory, info: WorldInfo) -> str:
    """Return the numerical results of a flight as text."""
    fuel = f', {flight.fuel[0] - flight.fuel[-1]:.0f} kg of fuel' if info.fuel > 0 else ''
    return (
        f'{flight.speed[-1]:.2f} m/s, {flight.tilt[-1]:.1f}°, '
        f'{flight.distance[-1]:.1f} m from the centre{fuel}, '
        f'{(len(flight) - 1) * info.dt:.1f} s, return {flight.total_return:.1f}')


def log_flight(
    stream: rr.RecordingStream, flight: Trajectory, info: WorldInfo, at: Timepoint,
    settling: Settling | None = None, look: Scenery | None = None,
) -> None:
    """Log an ended flight at a position of the recording, with its motion after touchdown.

    :param look: scenery to use instead of that of the world.
    :raises ValueError: when the settling's samples are not as wide as the flight's.
    """
    if settling is not None and settling.values.shape[1:] != flight.values.shape[1:]:
        raise ValueError(
            f'settling: samples are {settling.values.shape[1:]} wide, expected '
            f'{flight.values.shape[1:]}')
    look = look or scenery(info.world)
    whole = flight.followed_by(settling)
    strange = unusual(flight.values, flight.layout, info)
    recorded = (look.recorded, plots.UNUSUALS) if strange else (look.recorded,)
    _rocket(stream, whole, info, at, look, recorded)
    log_camera(stream, whole, info, at, look.camera)
    for effect in look.effects:
        effect(stream, whole, info, at)
    if strange:
        log_conditions(stream, whole, info, at)
    _trail(stream, whole, info, at, look)
    _phases(stream, flight, settling, info, at, look)
    _landing(stream, flight, settling, info, at, look)


def _rocket(
    stream: rr.RecordingStream, flight: Trajectory, info: WorldInfo, at: Timepoint,
    look: Scenery, recorded: Sequence[tuple[Plot, ...]],
) -> None:
    """Log pose, arrows and plots: one row per step and an empty one to end the lines.

    :param recorded: the plots, by the kind of their records.
    """
    n = len(flight)
    rows = np.append(np.arange(n), n - 1)
    position, quaternion = flight.position[rows], flight.orientation[rows]
    count = 2 if look.thrust else 1
    arrows = np.zeros((n + 1, count, 3))
    arrows[:n, 0] = info.unit * look.velocity * to_body(
        flight.orientation, flight.linear_velocity)
    if look.thrust:
        arrows[:n, 1, 2] = info.unit * look.thrust * flight.throttle
    stream.send_columns(
        entities.ROCKET, at.times(np.append(np.arange(n), n), info.dt), [
            *rr.Transform3D.columns(
                translation=position.astype(np.float32),
                quaternion=quaternion.astype(np.float32)),
            *rr.Arrows3D.columns(
                vectors=arrows.reshape(-1, 3).astype(np.float32)).partition([count] * (n + 1)),
            *(column for kind in recorded for column in plots.columns(kind, flight, info)),
        ])


def _trail(
    stream: rr.RecordingStream, flight: Trajectory, info: WorldInfo, at: Timepoint,
    look: Scenery,
) -> None:
    """Log a trail, blue for falling and amber for burning."""
    end = every(TRAIL_STEP, len(flight))[1:]
    start = np.maximum(end - TRAIL_STEP, 0)
    rows = np.linspace(start, end, 2 + look.bends, axis=1).astype(np.int64)
    lines = flight.position[rows].astype(np.float32)
    colours = np.array((palette.FALL, palette.BURN), np.uint8)[
        (flight.throttle[end] > 0.0).astype(np.int64)]
    stream.send_columns(
        entities.TRAIL, at.times(end, info.dt), rr.LineStrips3D.columns(
            strips=lines, colors=colours))


def phases(flight: Trajectory, shortest: int = 5) -> list[tuple[int, str]]:
    """Return (row, phase) for each phase: 'fall', 'burn' or 'settling', and finally the outcome.

    It is settling when it touches the ground with its engine off. The outcome of an unfinished
    flight is empty. Phases of less than `shortest` steps are omitted, as the throttle may chatter.
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
    stream: rr.RecordingStream, flight: Trajectory, settling: Settling | None, info: WorldInfo,
    at: Timepoint, look: Scenery,
) -> None:
    """Log the phases of the flight, and the outcome as a label above the rocket."""
    changes = phases(flight)
    whole = flight.followed_by(settling)
    state = flight.outcome
    if settling is not None and len(settling.values):
        state = settling.verdict
        changes += [(len(flight), palette.SETTLING), (len(whole) - 1, state)]
    # Repeated at the end of the pause, so that the recording extends beyond the flight.
    changes.append((len(whole) + pause_steps(info) - 2, state))
    text = (
        f'{ending(flight, settling)}\n'
        f'{flight.speed[-1]:.1f} m/s  {flight.tilt[-1]:.1f}°  {flight.distance[-1]:.1f} m')
    above = whole.position[-1] + whole.up[-1] * look.label * info.unit
    shown = [0] * (len(changes) - 2) + [1, 1]
    stream.send_columns(
        entities.PHASE, at.times(np.array([row for row, _ in changes]), info.dt), [
            *rr.StateChange.columns(state=[name for _, name in changes]),
            *rr.Points3D.columns(
                positions=[above] * 2, colors=[palette.light(_colour(flight, info))] * 2,
                labels=[text] * 2).partition(shown),
        ])


def _colour(flight: Trajectory, info: WorldInfo) -> palette.Colour:
    return palette.outcome_colours(info.outcomes).get(flight.outcome, palette.GREY)


def touchdown(flight: Trajectory, info: WorldInfo, reach: float = 1.0) -> NDArray[np.float64]:
    """Return the position, `(3,)`, of a flight's end mark: on the ground if it touched.

    :param reach: maximum height of a touching origin, in :attr:`WorldInfo.unit`.
    """
    mark: NDArray[np.float64] = flight.position[-1].copy()
    ground = 0.0
    if flight.layout.heights:
        half = info.field_half_width
        terrain = flight.terrain[-1]
        ground = float(np.interp(mark[0], np.linspace(-half, half, len(terrain)), terrain))
    if mark[2] - ground <= reach * info.touchdown_height:
        mark[2] = ground + 0.25 * info.scale
    return mark


def _landing(
    stream: rr.RecordingStream, flight: Trajectory, settling: Settling | None, info: WorldInfo,
    at: Timepoint, look: Scenery,
) -> None:
    """Log the path, which fades after a while, a permanent mark at its end, and a log line."""
    last = len(flight) - 1
    colour = _colour(flight, info)
    rows = np.unique(np.linspace(0, last, min(PATH_POINTS, last + 1)).astype(np.int64))
    text = (
        f'rocket {flight.row}, episode {flight.episode}: '
        f'{ending(flight, settling)}, {describe(flight, info)}')
    times = at.times(np.array([last]), info.dt)
    if at.iteration is not None:
        times.append(rr.TimeColumn('iteration', sequence=[at.iteration]))
    stream.send_columns(entities.PATHS, times, rr.LineStrips3D.columns(
        strips=[flight.position[rows].astype(np.float32)], colors=[(*colour, 110)]))
    stream.send_columns(
        entities.LANDINGS, times, [
            *rr.Points3D.columns(
                positions=[touchdown(flight, info, look.reach)], colors=[colour]),
            *rr.TextLog.columns(
                text=[text], level=['INFO' if flight.outcome == info.outcomes[0] else 'WARN']),
            *rr.DynamicArchetype.columns('Episode', components={
                'summary': _summary(flight, settling, info, at, look)}),
        ])



def _summary(
    flight: Trajectory, settling: Settling | None, info: WorldInfo, at: Timepoint,
    look: Scenery,
) -> pa.StructArray:
    """Return a flight's results beside its samples, as one record."""
    record = {
        'row': flight.row, 'episode': flight.episode, 'simulator_step': flight.step,
        'first_step': at.step, 'iteration': at.iteration or 0, 'samples': len(flight),
        'outcome': flight.outcome, 'return': flight.total_return,
        'speed': float(flight.speed[-1]), 'tilt': float(flight.tilt[-1]),
        'distance': float(flight.distance[-1]),
        'fuel_used': float(flight.fuel[0] - flight.fuel[-1]), 'tank': info.fuel,
        'start_fuel': float(flight.fuel[0]),
        'dt': info.dt, 'arrow': look.velocity * info.unit,
        'settled': 0 if settling is None else len(settling.values),
        'verdict': '' if settling is None else settling.verdict,
        'conditions': json.dumps(drawn(flight, info)),
    }
    return pa.array([record])
