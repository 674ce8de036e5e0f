# SPDX-License-Identifier: Apache-2.0
"""Snapshots taken apart and put together again, as a forger would."""
from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import SimulatedWorld


def contents(state: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays in a snapshot."""
    with np.load(io.BytesIO(state)) as archive:
        return dict(archive)


def packed(arrays: dict[str, Any]) -> bytes:
    """Return arrays as bytes, as a forger would."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def assert_refused(world: SimulatedWorld, state: bytes, message: str) -> None:
    """Assert that `restore` raises ValueError, tells why and changes nothing."""
    before = world.snapshot()
    with pytest.raises(ValueError, match=message):
        world.restore(state)
    assert world.snapshot() == before


def assert_value_refused(world: SimulatedWorld, name: str, value: float, message: str) -> None:
    """Assert the same of the world's own snapshot with another first value in an array."""
    arrays = contents(world.snapshot())
    arrays[name].flat[0] = value
    assert_refused(world, packed(arrays), message)
