# SPDX-License-Identifier: Apache-2.0
"""Units of observations and actions, for those who fly a policy outside of these worlds."""
from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.lunar import vehicle
from rocket_sim_node.worlds.lunar import view


class Unit(NamedTuple):
    """Unit of one entry: the entry times `scale` is the quantity in `unit`."""

    unit: str
    """SI, or `1` for pure numbers; empty where it is not known."""
    scale: float = 1.0


_PURE = Unit('1')
_UNKNOWN = Unit('')
_ROCKET = {
    'position': ('m', 'position_scale'), 'pad': ('m', 'position_scale'),
    'velocity': ('m/s', 'velocity_scale'), 'spin': ('rad/s', 'spin_scale'),
    'acceleration': ('m/s^2', 'acceleration_scale')}
"""Unit and setting with the scale, by the first word of an observation's name."""
_speed = view.seen_velocity(np.ones((1, len(view.OBSERVATION_NAMES))))
_LANDER = {
    'position_x': Unit('m', vehicle.HALF_WIDTH), 'position_y': Unit('m', vehicle.HALF_HEIGHT),
    'velocity_x': Unit('m/s', _speed[0].item()), 'velocity_y': Unit('m/s', _speed[1].item()),
    'angle': Unit('rad'), 'angular_velocity': Unit('rad/s', 2.5),  # Gymnasium's 50 / 20
    'right_contact': _PURE, 'left_contact': _PURE}
_LANDER_CHOICES = ('none', 'left', 'main', 'right')
_ACTIONS = ('throttle', 'rcs_x', 'rcs_z', 'main', 'lateral', 'engine')


def observation_units(spec: WorldSpec) -> tuple[Unit, ...]:
    """Return the units of the D entries of an observation."""
    if spec.name == 'lunar_lander':
        return tuple(_LANDER.get(name, _UNKNOWN) for name in spec.observation_names)
    return tuple(_rocket(name, spec) for name in spec.observation_names)


def action_units(spec: WorldSpec) -> tuple[Unit, ...]:
    """Return the units of the entries of an action: shares of what the vehicle can do."""
    return tuple(_PURE if name in _ACTIONS else _UNKNOWN for name in spec.action_names)


def action_choices(spec: WorldSpec) -> tuple[str, ...]:
    """Return what each discrete action fires, in order; empty if continuous or not known."""
    return _LANDER_CHOICES if spec.name == 'lunar_lander' and not spec.continuous else ()


def _rocket(name: str, spec: WorldSpec) -> Unit:
    first = name.partition('_')[0]
    if first in _ROCKET:
        unit, scale = _ROCKET[first]
        return Unit(unit, spec.settings[scale]) if scale in spec.settings else _UNKNOWN
    return _PURE if first in ('up', 'command') else _UNKNOWN
