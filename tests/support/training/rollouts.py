# SPDX-License-Identifier: Apache-2.0
"""Actions of roll-outs, and their bitwise comparison."""
from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from rocket_sim_node.worlds import Episodes


def random_actions(rockets: int, steps: int, seed: int = 0) -> np.ndarray:
    """Return random actions `(steps, rockets, 3)` within their bounds."""
    return np.random.default_rng(seed).uniform(-1, 1, (steps, rockets, 3)).astype(np.float32)


def assert_same(ours: tuple[Any, ...], theirs: tuple[Any, ...]) -> None:
    """Assert that two results of `step` are equal, bit for bit and with the same types."""
    for a, b in zip(ours[:4], theirs[:4], strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)
    for name in ('final_rows', 'final_observation'):
        np.testing.assert_array_equal(ours[4][name], theirs[4][name])
    for field in fields(Episodes):
        a, b = (getattr(answer[4]['episodes'], field.name) for answer in (ours, theirs))
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)
