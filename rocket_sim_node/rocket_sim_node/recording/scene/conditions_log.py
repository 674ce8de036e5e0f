# SPDX-License-Identifier: Apache-2.0
"""The conditions drawn for a flight that is not nominal, and their effect on it.

Nothing of this is in a recording whose flights are all nominal.
"""
from __future__ import annotations

from functools import cache

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from rocket_sim_node import settings
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing import palette
from rocket_sim_node.recording.drawing import plots
from rocket_sim_node.recording.drawing.timepoint import Timepoint
from rocket_sim_node.recording.scene import effects
from rocket_sim_node.recording.scene import rocket_model
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.settings import SettingInfo
from rocket_sim_node.telemetry.samples import Layout
from rocket_sim_node.worlds.rocket.conditions import LOW
from rocket_sim_node.worlds.rocket.conditions import ConditionSettings

F64 = NDArray[np.float64]

ARROW = 25.0
"""m of arrow for 1 m/s^2, for a vehicle as large as drawn"""
IN_FRONT = 8.0
"""m by which the arrow stands in front of the vehicle, which has a radius, where that is planar"""
_HEIGHT = rocket_model.NOSE / 2
"""m above the vehicle's origin at which the arrow begins"""
_INFOS = {
    info.name.removesuffix(LOW): info for info in settings.describe(ConditionSettings)
    if info.name.endswith(LOW)}
_DIRECTIONS = {'side_acceleration': 'side_direction', 'wind_speed': 'wind_direction'}
"""of those conditions that have one, where it is drawn"""


@cache
def _ranges(names: tuple[str, ...]) -> tuple[NDArray[np.int64], F64]:
    """Return the columns of what is drawn from ranges that are known, and the nominal values."""
    known = [column for column, name in enumerate(names) if name in _INFOS]
    return np.array(known, np.int64), np.array(
        [float(_default(_INFOS[names[column]])) for column in known])


def _default(info: SettingInfo) -> float:
    assert isinstance(info.default, int | float)
    return info.default


def unusual(values: F64, layout: Layout, stage: WorldInfo) -> bool:
    """Tell whether samples are of flights whose conditions are not nominal.

    :param values: `(S, layout.width)`, as of :class:`Samples`.
    :raises ValueError: when they have other conditions than the stage names.
    """
    names = stage.condition_names
    if names and layout.conditions != len(names):
        raise ValueError(
            f'conditions: {layout.conditions} values a sample, expected {len(names)}, as world '
            f'{stage.world!r} has')
    if values[:, layout.place('disturbance')].any():
        return True
    columns, nominal = _ranges(names)
    return bool((values[:, layout.place('conditions')][:, columns] != nominal).any())


def drawn(flight: Trajectory, stage: WorldInfo) -> dict[str, float]:
    """Return by name what was drawn for a flight, where that is not nominal."""
    first = flight.conditions[0].tolist() if stage.condition_names else []
    found = dict(zip(stage.condition_names, first, strict=True))
    ranges = {
        name: value for name, value in found.items()
        if name in _INFOS and value != _INFOS[name].default}
    return {**ranges, **{
        direction: found[direction] for name, direction in _DIRECTIONS.items()
        if name in ranges and direction in found}}


def text(flight: Trajectory, stage: WorldInfo) -> str:
    """Return in Markdown what was drawn for a flight."""
    found = drawn(flight, stage)
    lines = [
        f'### Rocket {flight.row}, episode {flight.episode}', '',
        '| condition | drawn | nominal |', '| --- | --- | --- |']
    for name, value in found.items():
        if name not in _INFOS:
            continue
        info = _INFOS[name]
        unit = f' {info.unit}' if info.unit else ''
        towards = _towards(name, value, found, stage) if name in _DIRECTIONS else ''
        lines.append(
            f'| {palette.words(name)} | {value:.4g}{unit}{towards} | {info.default:g}{unit} |')
    return '\n'.join([*lines, '', 'All else is nominal.'])


def _towards(name: str, value: float, found: dict[str, float], stage: WorldInfo) -> str:
    direction = found.get(_DIRECTIONS[name], 0.0)
    if stage.world == 'rocket_planar':  # which has no more of it
        return f', {value * np.cos(direction):.3g} along x'
    # It is drawn from x towards the world's z, y up; that is -y here.
    return f', towards {-np.rad2deg(direction) % 360:.0f}° from x'


def log_style(stream: rr.RecordingStream, stage: WorldInfo, *, plotted: bool = True) -> None:
    """Log what the arrow of the disturbance looks like, and the lines of the plots."""
    in_front = IN_FRONT if stage.world == 'rocket_planar' else 0.0
    stream.log(entities.DISTURBANCE, rr.Arrows3D.from_fields(
        colors=[palette.YELLOW], radii=[0.35 * stage.scale],
        origins=[(0.0, -in_front * stage.scale, _HEIGHT * stage.scale)]), static=True)
    if plotted:
        plots.log_styles(stream, entities.ROCKET, plots.UNUSUALS)


def log_conditions(
    stream: rr.RecordingStream, flight: Trajectory, stage: WorldInfo, place: Timepoint,
) -> None:
    """Log what was drawn, and side acceleration and gusts as an arrow."""
    n = len(flight)
    stream.send_columns(
        entities.CONDITIONS, place.times(np.array([0]), stage.dt),
        rr.TextDocument.columns(
            text=[text(flight, stage)], media_type=[rr.MediaType.MARKDOWN]))
    if not flight.disturbance.any():
        return
    # In the frame of the body, with which the entity moves; a last row takes the arrow away.
    vectors = effects.to_body(flight.orientation, ARROW * stage.scale * flight.disturbance)
    stream.send_columns(
        entities.DISTURBANCE, place.times(np.arange(n + 1), stage.dt),
        rr.Arrows3D.columns(vectors=vectors.astype(np.float32)).partition(
            [1] * n + [0]))
