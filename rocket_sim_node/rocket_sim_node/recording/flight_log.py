# SPDX-License-Identifier: Apache-2.0
"""One flight on the timelines of a recording: a few `send_columns`, one per entity."""
from __future__ import annotations

import itertools

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]  # it has no types
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node.recording import palette
from rocket_sim_node.recording import scene
from rocket_sim_node.recording import vehicle
from rocket_sim_node.recording.camera import log_camera
from rocket_sim_node.recording.place import Place
from rocket_sim_node.recording.place import changed
from rocket_sim_node.recording.samples import Flight
from rocket_sim_node.recording.stage import Stage

F32 = NDArray[np.float32]

PAUSE = 2.0
"""s of standing still after a flight, for the eye, before the next one begins"""
ARROW = 0.9
"""m of velocity arrow per m/s"""
THRUST_ARROW = 16.0
"""m of thrust arrow at full throttle"""
FLAME_LENGTH = (5.0, 20.0)
"""m of flame when the engine is on, and more at full throttle"""
FLAME_WIDTH = 1.5
EFFECT_STEP = 5
"""Flame and puffs are logged every so many steps."""
TRAIL_STEP = 12
PATH_POINTS = 40


def pause_steps(stage: Stage) -> int:
    """Return how many steps lie between the end of a flight and the start of the next."""
    return int(np.ceil(PAUSE / stage.dt))


def describe(flight: Flight, stage: Stage) -> str:
    """Return how a flight ended, in words."""
    fuel = flight.fuel[0] - flight.fuel[-1]
    return (
        f'{flight.speed[-1]:.2f} m/s, {flight.tilt[-1]:.1f}°, '
        f'{flight.distance[-1]:.1f} m from the centre, {fuel:.0f} kg of fuel, '
        f'{(len(flight) - 1) * stage.dt:.1f} s, return {flight.total_return:.1f}')


def log_flight(stream: rr.RecordingStream, flight: Flight, stage: Stage, place: Place) -> None:
    """Log a finished flight, `(n, 22)` samples, at its place."""
    _rocket(stream, flight, stage, place)
    log_camera(stream, flight, stage, place)
    _flame(stream, flight, stage, place)
    _puffs(stream, flight, stage, place)
    _trail(stream, flight, stage, place)
    _phases(stream, flight, stage, place)
    _landing(stream, flight, stage, place)


def _rocket(stream: rr.RecordingStream, flight: Flight, stage: Stage, place: Place) -> None:
    """Pose, velocity arrow and plots: one row a step and one more, empty, to end the lines."""
    n = len(flight)
    rows = np.append(np.arange(n), n - 1)
    position, quaternion = flight.position[rows], flight.orientation[rows]
    arrows = np.zeros((n + 1, 2, 3))
    arrows[:n, 0] = ARROW * to_body(flight.orientation, flight.linear_velocity)
    arrows[:n, 1, 2] = THRUST_ARROW * stage.scale * flight.throttle
    # What stands at the first sample belongs to no step of this flight.
    reward = np.append(0.0, flight.reward[1:])
    plots = {
        'motion': (flight.position[:, 2] - stage.touchdown_height, flight.speed),
        'tilt': (flight.tilt,),
        'engine': (100.0 * flight.throttle, 100.0 * flight.fuel / max(stage.fuel, 1e-9)),
        'reward': (np.cumsum(reward), reward),
    }
    stream.send_columns(
        scene.ROCKET, place.times(np.append(np.arange(n), n), stage.dt), [
            *rr.Transform3D.columns(
                translation=position.astype(np.float32),
                quaternion=quaternion.astype(np.float32)),
            *rr.Arrows3D.columns(
                vectors=arrows.reshape(-1, 3).astype(np.float32)).partition([2] * (n + 1)),
            *(column for name, lines in plots.items() for column in _plot(name, lines)),
        ])


def _plot(name: str, lines: tuple[NDArray[np.float64], ...]) -> rr.ComponentColumnList:
    """Return the lines of one plot, `(n,)` each, as a column of n + 1 rows that ends in a gap."""
    table = np.full((len(lines[0]) + 1, len(lines)), np.nan, np.float32)
    table[:-1] = np.stack(lines, axis=1)
    return rr.DynamicArchetype.columns(
        'Flight', components={name: table.ravel()}).partition([len(lines)] * len(table))


def to_body(quaternion: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return world vectors `(n, 3)` in the frame of bodies with attitudes `(n, 4)`."""
    axis, real = -quaternion[:, :3], quaternion[:, 3:]
    twice = 2.0 * np.cross(axis, vector)
    return vector + real * twice + np.cross(axis, twice)


def _every(step: int, n: int) -> NDArray[np.int64]:
    """Return every so many of n rows, and the last."""
    return np.unique(np.append(np.arange(0, n, step), n - 1))


def _flame(stream: rr.RecordingStream, flight: Flight, stage: Stage, place: Place) -> None:
    """Stretch the flame by the throttle; it flickers a little, and vanishes at the end."""
    rows = _every(EFFECT_STEP, len(flight))
    throttle = np.append(flight.throttle[rows[:-1]], 0.0)
    flicker = 1.0 + 0.06 * np.where(np.arange(len(rows)) % 2, 1.0, -1.0)
    scale = np.full((len(rows), 3), FLAME_WIDTH)
    scale[:, 2] = (FLAME_LENGTH[0] + FLAME_LENGTH[1] * throttle) * flicker
    scale[throttle <= 0.0] = 1e-3
    keep = changed(scale)
    stream.send_columns(
        scene.FLAME, place.times(rows[keep], stage.dt),
        rr.Transform3D.columns(scale=(scale[keep] * stage.scale).astype(np.float32)))


def _puffs(stream: rr.RecordingStream, flight: Flight, stage: Stage, place: Place) -> None:
    """Blow gas at the top of the body, away from where the torque pushes it."""
    rows = _every(EFFECT_STEP, len(flight))
    torque = flight.torque[rows] / stage.max_torque
    push = np.cross(torque, flight.up[rows])
    gas = -to_body(flight.orientation[rows], push)
    strength = np.minimum(np.hypot(gas[:, 0], gas[:, 1]), 1.0)
    strength[-1] = 0.0
    # Steps of a tenth: what nobody sees need not be stored.
    strength = np.round(strength, 1)
    angle = np.where(strength > 0.0, np.round(np.arctan2(gas[:, 1], gas[:, 0]), 1), 0.0)
    keep = changed(np.stack((strength, angle), axis=1))
    half = angle[keep] / 2
    quaternion = np.stack((0 * half, 0 * half, np.sin(half), np.cos(half)), axis=1)
    size = np.where(strength[keep] > 0, 0.3 + 0.7 * strength[keep], 1e-3) * stage.scale
    stream.send_columns(
        scene.PUFF, place.times(rows[keep], stage.dt), rr.Transform3D.columns(
            quaternion=quaternion.astype(np.float32),
            scale=np.repeat(size[:, None], 3, axis=1).astype(np.float32)))


def _trail(stream: rr.RecordingStream, flight: Flight, stage: Stage, place: Place) -> None:
    """Leave a line behind, blue where the rocket falls and amber where it burns."""
    end = _every(TRAIL_STEP, len(flight))[1:]
    start = np.maximum(end - TRAIL_STEP, 0)
    lines = np.stack((flight.position[start], flight.position[end]), axis=1).astype(np.float32)
    colours = np.array((palette.FALL, palette.BURN), np.uint8)[
        (flight.throttle[end] > 0.0).astype(np.int64)]
    stream.send_columns(
        scene.TRAIL, place.times(end, stage.dt), rr.LineStrips3D.columns(
            strips=list(lines), colors=colours))


def phases(flight: Flight, shortest: int = 5) -> list[tuple[int, str]]:
    """Return (row, phase) where a phase begins: 'fall' or 'burn', at last the outcome.

    The outcome of an unfinished flight is empty. A phase of less than `shortest` steps is left
    out: the throttle may chatter.
    """
    burning = flight.throttle > 0.0
    edges = np.flatnonzero(np.diff(burning)) + 1
    starts = [0, *edges.tolist(), len(flight) - 1]
    changes: list[tuple[int, str]] = []
    for start, end in itertools.pairwise(starts):
        name = 'burn' if burning[start] else 'fall'
        if (end - start >= shortest or not changes) and (not changes or changes[-1][1] != name):
            changes.append((start, name))
    changes.append((len(flight) - 1, flight.outcome))
    return changes


def _phases(stream: rr.RecordingStream, flight: Flight, stage: Stage, place: Place) -> None:
    """Say in which phase the flight is, and above the rocket, until the next, how it ended."""
    changes = phases(flight)
    # Said again at the end of the pause, so that the recording does not end with the flight.
    changes.append((len(flight) + pause_steps(stage) - 2, flight.outcome))
    text = (
        f'{(flight.outcome or "unfinished").replace("_", " ")}\n'
        f'{flight.speed[-1]:.1f} m/s  {flight.tilt[-1]:.1f}°  {flight.distance[-1]:.1f} m')
    nose = flight.position[-1] + flight.up[-1] * (vehicle.NOSE + 5.0) * stage.scale
    shown = [0] * (len(changes) - 2) + [1, 1]
    stream.send_columns(
        scene.PHASE, place.times(np.array([row for row, _ in changes]), stage.dt), [
            *rr.StateChange.columns(state=[name for _, name in changes]),
            *rr.Points3D.columns(
                positions=[nose] * 2, colors=[palette.light(_colour(flight, stage))] * 2,
                labels=[text] * 2).partition(shown),
        ])


def _colour(flight: Flight, stage: Stage) -> palette.Colour:
    return palette.outcome_colours(stage.outcomes).get(flight.outcome, palette.GREY)


def _landing(stream: rr.RecordingStream, flight: Flight, stage: Stage, place: Place) -> None:
    """Leave the path for a while, a mark at its end for all time, and a line in the log."""
    last = len(flight) - 1
    colour = _colour(flight, stage)
    mark = flight.position[-1].copy()
    if mark[2] <= stage.touchdown_height:
        mark[2] = 0.25
    rows = np.unique(np.linspace(0, last, min(PATH_POINTS, last + 1)).astype(np.int64))
    text = (
        f'rocket {flight.row}, episode {flight.episode}: '
        f'{(flight.outcome or "unfinished").replace("_", " ")}, {describe(flight, stage)}')
    times = [
        *place.times(np.array([last]), stage.dt),
        rr.TimeColumn('iteration', sequence=[place.iteration])]
    stream.send_columns(scene.PATHS, times, rr.LineStrips3D.columns(
        strips=[flight.position[rows].astype(np.float32)], colors=[(*colour, 110)]))
    stream.send_columns(
        scene.LANDINGS, times, [
            *rr.Points3D.columns(positions=[mark], colors=[colour]),
            *rr.TextLog.columns(
                text=[text], level=['INFO' if flight.outcome == stage.outcomes[0] else 'WARN']),
            *rr.DynamicArchetype.columns(
                'Episode', components={'summary': _summary(flight, stage, place)}),
        ])


def _summary(flight: Flight, stage: Stage, place: Place) -> pa.StructArray:
    """Return what there is to know of a flight beside its samples, as one record."""
    record = {
        'row': flight.row, 'episode': flight.episode, 'simulator_step': flight.step,
        'first_step': place.step, 'iteration': place.iteration, 'samples': len(flight),
        'outcome': flight.outcome, 'return': flight.total_return,
        'speed': float(flight.speed[-1]), 'tilt': float(flight.tilt[-1]),
        'distance': float(flight.distance[-1]),
        'fuel_used': float(flight.fuel[0] - flight.fuel[-1]), 'tank': stage.fuel,
        'dt': stage.dt,
    }
    return pa.array([record])
