# SPDX-License-Identifier: Apache-2.0
"""Properties of a world that determine its appearance in recordings."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field

from rocket_sim_node.worlds.base import WorldSpec
from rocket_sim_node.worlds.lunar import vehicle

DRAWN_HEIGHT = 5.2
"""m from the feet to the origin of the vehicle as drawn; other vehicles are scaled to fit."""

UNSAID: Mapping[str, Mapping[str, float]] = {
    'lunar_lander': {
        'touchdown_height': vehicle.LEG_DOWN, 'landed_distance': 2.0, 'fuel': 0.0},
}
"""Values that some worlds' descriptions lack."""


@dataclass(frozen=True)
class WorldInfo:
    """A world as shown in its recordings; SI units.

    `fuel` is 0 for a world without it; `stance` is the distance of the feet from the axis, as seen
    in a planar world, and `field_half_width` the half-width of the terrain. `condition_names`
    names the values drawn for each episode, in the order of the samples' `conditions`.
    """

    world: str
    dt: float
    outcomes: tuple[str, ...]
    touchdown_height: float = DRAWN_HEIGHT
    landed_distance: float = 15.0
    range_limit: float = 200.0
    fuel: float = 2_000.0
    max_torque: float = 2e6
    stance: float = 6.7
    field_half_width: float = 10.0
    condition_names: tuple[str, ...] = ()
    settings: Mapping[str, float] = field(default_factory=dict, hash=False, repr=False)
    """All settings in the world's description."""

    @classmethod
    def of(cls, spec: WorldSpec) -> WorldInfo:
        """Take the properties from a world's description."""
        return cls.build(
            spec.name, spec.dt, spec.outcomes, spec.settings, spec.condition_names)

    @classmethod
    def build(
        cls, world: str, dt: float, outcomes: tuple[str, ...], settings: Mapping[str, float],
        condition_names: tuple[str, ...] = (),
    ) -> WorldInfo:
        """Take the known properties from a world's settings; the rest has defaults."""
        known = {**UNSAID.get(world, {}), **settings}

        def value(name: str, default: float) -> float:
            return float(known.get(name, default))

        return cls(
            world, dt, outcomes,
            touchdown_height=value('touchdown_height', cls.touchdown_height),
            landed_distance=value('landed_distance', cls.landed_distance),
            range_limit=value('range_limit', cls.range_limit),
            fuel=value('fuel', cls.fuel),
            max_torque=value('rcs_torque', cls.max_torque) or cls.max_torque,
            stance=value('stance', cls.stance),
            field_half_width=value('field_half_width', cls.field_half_width),
            condition_names=condition_names, settings=dict(settings),
        )

    @property
    def unit(self) -> float:
        """Height of the vehicle's origin above the ground when it stands, m, never 0."""
        return self.touchdown_height if self.touchdown_height > 0 else DRAWN_HEIGHT

    @property
    def scale(self) -> float:
        """Size of the vehicle relative to its drawing."""
        return self.unit / DRAWN_HEIGHT
