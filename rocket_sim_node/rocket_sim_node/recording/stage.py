# SPDX-License-Identifier: Apache-2.0
"""What a recording needs to know of a world: the numbers that shape its picture."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

DRAWN_HEIGHT = 5.2
"""m from the feet to the origin of the vehicle as it is drawn; others are scaled to fit."""


@dataclass(frozen=True)
class Stage:
    """A world as its recordings show it; SI units."""

    world: str
    dt: float
    outcomes: tuple[str, ...]
    touchdown_height: float = DRAWN_HEIGHT
    landed_distance: float = 15.0
    range_limit: float = 200.0
    fuel: float = 2_000.0
    max_torque: float = 2e6
    level: int = 0

    @classmethod
    def build(
        cls, world: str, dt: float, outcomes: tuple[str, ...], settings: Mapping[str, float],
    ) -> Stage:
        """Take from a world's settings what is known here; the rest keeps its default."""
        def value(name: str, default: float) -> float:
            return float(settings.get(name, default))

        return cls(
            world, dt, outcomes,
            touchdown_height=value('touchdown_height', cls.touchdown_height),
            landed_distance=value('landed_distance', cls.landed_distance),
            range_limit=value('range_limit', cls.range_limit),
            fuel=value('fuel', cls.fuel),
            max_torque=value('rcs_torque', cls.max_torque),
            level=int(value('level', cls.level)),
        )

    @property
    def scale(self) -> float:
        """How much larger than drawn the vehicle is."""
        return self.touchdown_height / DRAWN_HEIGHT if self.touchdown_height > 0 else 1.0
