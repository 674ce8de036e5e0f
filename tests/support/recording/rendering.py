# SPDX-License-Identifier: Apache-2.0
"""Pictures of recordings for tests, if this machine can render them."""
from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rocket_sim_node.recording import render


def pictures(recording: Path, times: list[float], **how: Any) -> list[np.ndarray]:
    """Return pictures of the viewer at some times, `(rows, columns, 3)` each.

    Without a graphics driver the test is skipped; in continuous integration it fails.
    """
    try:
        drawn = render.render(recording, times, **{'size': (960, 600), 'patience': 60.0, **how})
    except render.RendererMissing as error:
        if os.environ.get('CI') == 'true':
            raise
        pytest.skip(str(error))
    return [np.asarray(picture, np.int64) for picture in drawn]


def colours(pixels: np.ndarray) -> int:
    """Return the number of colours; an empty view has only a few."""
    return len(np.unique(pixels.reshape(-1, 3), axis=0))


def of_vehicle(pixels: np.ndarray, world: str) -> np.ndarray:
    """Return which pixels have the colour of the lander's hull, or of the rocket's band."""
    red, green, blue = np.moveaxis(pixels, -1, 0)
    if world == 'lunar_lander':
        return (blue > 190) & (blue - green > 60) & (red < 190)
    return (blue - red > 60) & (blue - green > 25) & (blue > 80) & (red < 30)
