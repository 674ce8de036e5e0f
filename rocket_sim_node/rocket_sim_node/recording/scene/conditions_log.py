# SPDX-License-Identifier: Apache-2.0
"""Logging of a flight's conditions that are not nominal, and of their effects.

A recording of nominal flights only contains none of this.
"""
from __future__ import annotations

from functools import cache

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node import frames
from rocket_sim_node import palette
from rocket_sim_node import settings
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing import plots
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.scene import rocket_model
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.settings import SettingInfo
from rocket_sim_node.telemetry.samples import Layout
from rocket_sim_node.worlds.rocket.conditions import LOW
from rocket_sim_node.worlds.rocket.conditions import ConditionSettings

F64 = NDArray[np.float64]

ARROW = 25.0
"""m of arrow for 1 m/s^2, for a rocket as large as drawn."""
_HEIGHT = rocket_model.NOSE / 2
_ARROWS = {'rocket_planar': (ARROW, 8.0, _HEIGHT), 'lunar_lander': (5.0, 3.0, 8.0)}
"""Of the arrow in planar worlds: m for 1 m/s^2; m of its origin in front of the vehicle, which has
a radius, and above the vehicle's origin; for a vehicle as large as drawn."""
_SPATIAL = (ARROW, 0.0, _HEIGHT)
_INFOS = {
    info.name.removesuffix(LOW): info for info in settings.describe(ConditionSettings)
    if info.name.endswith(LOW)}
_DIRECTIONS = {'side_acceleration': 'side_direction', 'wind_speed': 'wind_direction'}
"""Per condition with a direction, the drawn quantity that holds it."""


@cache
def _ranges(names: tuple[str, ...]) -> tuple[NDArray[np.int64], F64]:
    """Return the columns of drawn values whose ranges are known, and their nominal values."""
    known = [column for column, name in enumerate(names) if name in _INFOS]
    return np.array(known, np.int64), np.array(
        [float(_default(_INFOS[names[column]])) for column in known])


def _default(info: SettingInfo) -> float:
    assert isinstance(info.default, int | float)
    return info.default


def unusual(values: F64, layout: Layout, info: WorldInfo) -> bool:
    """Return whether samples are of flights whose conditions are not nominal.

    :param values: `(S, layout.width)`, as of :class:`Samples`.
    :raises ValueError: when their conditions are not those of the world.
    """
    names = info.condition_names
    if names and layout.conditions != len(names):
        raise ValueError(
            f'conditions: {layout.conditions} values a sample, expected {len(names)}, as world '
            f'{info.world!r} has')
    if values[:, layout.place('disturbance')].any():
        return True
    columns, nominal = _ranges(names)
    return bool((values[:, layout.place('conditions')][:, columns] != nominal).any())


def drawn(flight: Trajectory, info: WorldInfo) -> dict[str, float]:
    """Return a flight's drawn conditions by name, where they are not nominal."""
    first = flight.conditions[0].tolist() if info.condition_names else []
    found = dict(zip(info.condition_names, first, strict=True))
    ranges = {
        name: value for name, value in found.items()
        if name in _INFOS and value != _INFOS[name].default}
    return {**ranges, **{
        direction: found[direction] for name, direction in _DIRECTIONS.items()
        if name in ranges and direction in found}}


def text(flight: Trajectory, info: WorldInfo) -> str:
    """Return a flight's drawn conditions as Markdown."""
    found = drawn(flight, info)
    lines = [
        f'### Rocket {flight.row}, episode {flight.episode}', '',
        '| condition | drawn | nominal |', '| --- | --- | --- |']
    for name, value in found.items():
        if name not in _INFOS:
            continue
        setting = _INFOS[name]
        unit = f' {setting.unit}' if setting.unit else ''
        towards = _towards(name, value, found, info) if name in _DIRECTIONS else ''
        lines.append(
            f'| {palette.words(name)} | {value:.4g}{unit}{towards} | {setting.default:g}{unit} |')
    return '\n'.join([*lines, '', 'All other conditions are nominal.'])


def _towards(name: str, value: float, found: dict[str, float], info: WorldInfo) -> str:
    direction = found.get(_DIRECTIONS[name], 0.0)
    if info.world == 'rocket_planar':  # along x, either way
        return f', {value * np.cos(direction):.3g} along x'
    # Drawn from x towards the world's z with y up, which is -y here.
    return f', towards {-np.rad2deg(direction) % 360:.0f}° from x'


def log_style(stream: rr.RecordingStream, info: WorldInfo, *, plotted: bool = True) -> None:
    """Log the style of the disturbance arrow and of the plots' lines."""
    _, in_front, height = _ARROWS.get(info.world, _SPATIAL)
    stream.log(entities.DISTURBANCE, rr.Arrows3D.from_fields(
        colors=[palette.YELLOW], radii=[0.35 * info.scale],
        origins=[(0.0, -in_front * info.scale, height * info.scale)]), static=True)
    if plotted:
        plots.log_styles(stream, entities.ROCKET, plots.UNUSUALS)


def log_conditions(
    stream: rr.RecordingStream, flight: Trajectory, info: WorldInfo, at: Timepoint,
) -> None:
    """Log the drawn conditions, and side acceleration and gusts as an arrow."""
    n = len(flight)
    stream.send_columns(
        entities.CONDITIONS, at.times(np.array([0]), info.dt),
        rr.TextDocument.columns(
            text=[text(flight, info)], media_type=[rr.MediaType.MARKDOWN]))
    if not flight.disturbance.any():
        return
    # In the body frame, with which the entity moves; a last row removes the arrow.
    length, _, _ = _ARROWS.get(info.world, _SPATIAL)
    vectors = frames.to_body(flight.orientation, length * info.scale * flight.disturbance)
    stream.send_columns(
        entities.DISTURBANCE, at.times(np.arange(n + 1), info.dt),
        rr.Arrows3D.columns(vectors=vectors.astype(np.float32)).partition(
            [1] * n + [0]))
