# SPDX-License-Identifier: Apache-2.0
"""Comparing roll-outs bit for bit."""
from __future__ import annotations

from typing import Any

import numpy as np


def assert_same(ours: tuple[Any, ...], theirs: tuple[Any, ...]) -> None:
    """Assert that two answers of `step` are the same, bit for bit and kind for kind."""
    for a, b in zip(ours[:4], theirs[:4], strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)
    for name in ('final_rows', 'final_observation'):
        np.testing.assert_array_equal(ours[4][name], theirs[4][name])
    for name in ('row', 'episode', 'episode_return', 'length', 'outcome', 'tilt', 'fuel_used'):
        np.testing.assert_array_equal(
            getattr(ours[4]['episodes'], name), getattr(theirs[4]['episodes'], name))
