# SPDX-License-Identifier: Apache-2.0
"""Table of the quantities of a rocket's state.

Telemetry of worlds, RocketState.msg, samples and recordings follow from it. A new quantity is one
row here, if a world has an attribute that holds it; otherwise the world derives it (see
`capture.StateCapture`).
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import DTypeLike
from numpy.typing import NDArray

from rocket_sim_node import frames
from rocket_sim_node import palette
from rocket_sim_node.palette import Colour

NO_OUTCOME = 255
"""Outcome of an episode that has not ended."""


@dataclass(frozen=True)
class Curves:
    """The plot of a quantity: the field of a recording's samples, title and lines.

    `lines` has name and colour of a line for each of the first numbers of the quantity. `unusual`:
    recorded only for flights under conditions that are not nominal. `behind` is the field of a
    plot in which these lines are drawn, instead of one of their own.
    """

    field: str
    title: str
    lines: Mapping[str, Colour]
    factor: float = 1.0
    unusual: bool = False
    behind: str = ''


def _same(values: NDArray[Any]) -> NDArray[Any]:
    return values


@dataclass(frozen=True)
class Quantity:
    """A quantity of a rocket's state.

    `meaning` is its comment in the message, beginning with the unit. `source` is the attribute,
    with dots, in which a world has it for N rockets, `(N,)` or `(width, N)`; without that
    attribute a world may derive the quantity, else it is 0. `width` is the number of values of a
    sample, or the letter of a number that depends on the world. `kind` is the type in the message,
    `dtype` that in this process. `to_ros` converts values `(S, width)` from y up to z up.
    """

    name: str
    meaning: str
    source: str = ''
    width: int | str = 1
    kind: str = 'f8'
    dtype: DTypeLike = np.float64
    to_ros: Callable[[NDArray[Any]], NDArray[Any]] = _same
    curves: Curves | None = field(default=None, kw_only=True)


_VECTOR: dict[str, Any] = {'width': 3, 'to_ros': frames.vector_to_ros}

QUANTITIES = (
    Quantity('row', 'rocket, 0 to N - 1', 'rows', 1, 'u4', np.int64),
    Quantity('episode', 'as in Episodes', 'episode', 1, 'u8', np.int64),
    Quantity('time', 's of simulated time since the episode began'),
    Quantity('position', 'm', 'position', **_VECTOR),
    Quantity(
        'orientation', 'quaternion x y z w, body to world', 'attitude', 4,
        to_ros=frames.quaternion_to_ros),
    Quantity('linear_velocity', 'm/s, world frame', 'velocity', **_VECTOR),
    Quantity('angular_velocity', 'rad/s, world frame', 'spin', **_VECTOR),
    Quantity('mass', 'kg, fuel included'),
    Quantity('fuel', 'kg', 'fuel'),
    Quantity(
        'throttle', '0 to 1, actual, during the step that led to this state', 'engines.throttle'),
    Quantity(
        'commanded_throttle', '0 to 1, commanded by the action of that step', curves=Curves(
            'commanded', 'Commanded throttle (%)', {'commanded': palette.GREY}, 100.0,
            unusual=True, behind='engine')),
    Quantity('thrust', "N, along the body's z"),
    Quantity('lateral_thrust', "N, of the side engines, along the body's x"),
    Quantity(
        'torque', "N m, of the attitude control, about the world's axes", 'torque', **_VECTOR),
    Quantity(
        'disturbance', 'm/s^2, side acceleration and gust, world frame', 'disturbance', **_VECTOR,
        curves=Curves(
            'disturbance', 'Side acceleration and gusts (m/s²)',
            {'along x': palette.SKY, 'along y': palette.ORANGE}, unusual=True)),
    Quantity(
        'contact_force', 'N, of the ground on the vehicle, world frame, mean over the step',
        'contact_force', **_VECTOR),
    Quantity(
        'contact', "1 where a leg touches the ground; left to right seen along the world's +y; L "
        'is 2 in planar worlds, 0 where there are no legs', '', 'L', 'u1', np.bool_),
    Quantity(
        'leg_angle', 'rad, outward rotation of the leg from its unloaded position', width='L'),
    Quantity(
        'terrain', "m, height of the ground at H equidistant points along the world's x, from "
        '-field_half_width to field_half_width (a setting of the world), joined by straight '
        'lines; H is 0 for flat ground at height 0', width='H'),
    Quantity(
        'conditions', 'values drawn for the episode, columns as in World.condition_names, in the '
        "units of those settings; directions in rad, in the world's own frame, y up, from x "
        'towards z', 'vehicles.drawn', 'C'),
    Quantity('reward', 'of the step that led to this state', 'reward'),
    Quantity(
        'outcome', 'index into World.outcomes, NONE before the end of the episode', 'no_outcome',
        1, 'u1', np.uint8),
)
