# SPDX-License-Identifier: Apache-2.0
"""Colour palette for all types of colour vision (Okabe and Ito, 2008), sRGB.

Recordings and reports use the same colours and names for outcomes.
"""
from __future__ import annotations

from typing import TypeAlias

Colour: TypeAlias = tuple[int, int, int]

GREEN: Colour = (0, 158, 115)
VERMILION: Colour = (213, 94, 0)
PURPLE: Colour = (204, 121, 167)
ORANGE: Colour = (230, 159, 0)
SKY: Colour = (86, 180, 233)
YELLOW: Colour = (240, 228, 66)
GREY: Colour = (150, 156, 168)
WHITE: Colour = (235, 238, 242)
BACKGROUND: Colour = (16, 20, 30)
SOIL: Colour = (50, 58, 66)
CONCRETE: Colour = (92, 98, 106)
PAINT: Colour = (240, 242, 246)
TARGET: Colour = (255, 206, 84)

_OUTCOMES = {
    'landed': GREEN, 'too_fast': VERMILION, 'tipped': PURPLE, 'off_pad': ORANGE,
    'tilt_limit': SKY, 'timeout': YELLOW, 'out_of_bounds': GREY, 'crashed': VERMILION,
}
_OTHERS = (VERMILION, PURPLE, ORANGE, SKY, YELLOW, GREY)

FALL: Colour = (88, 104, 140)
BURN: Colour = (255, 176, 56)
PHASES = {'fall': FALL, 'burn': BURN}
"""Colours of a flight's phases: engine off, engine on; its outcome follows."""
SETTLING = 'settling'
VERDICTS = {
    SETTLING: FALL, 'stands': GREEN, 'slides': ORANGE, 'bounces': SKY, 'tips_over': VERMILION}
"""Colours of the phase after a touchdown, and of its verdicts."""


def outcome_colours(outcomes: tuple[str, ...]) -> dict[str, Colour]:
    """Return a colour for each outcome: green for the first, a success; all are different."""
    colours = {name: _OUTCOMES[name] for name in outcomes if name in _OUTCOMES}
    for index, name in enumerate(outcomes):
        free = [other for other in _OTHERS if other not in colours.values()] or list(_OTHERS)
        colours.setdefault(name, GREEN if index == 0 else free[index % len(free)])
    return {name: colours[name] for name in outcomes}


def words(name: str) -> str:
    """Return the name of an outcome, a verdict or a quantity as text for display."""
    return name.replace('_', ' ')


def light(colour: Colour) -> Colour:
    """Return a colour half way to white, for text on a dark background."""
    return ((colour[0] + 255) // 2, (colour[1] + 255) // 2, (colour[2] + 255) // 2)
