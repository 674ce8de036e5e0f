# SPDX-License-Identifier: Apache-2.0
"""Tools that unpack, change and repack snapshots, to forge them."""
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
    """Return the arrays as the bytes of a snapshot."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def assert_refused(world: SimulatedWorld, state: bytes, message: str) -> None:
    """Assert that `restore` raises ValueError with a message and changes nothing."""
    before = world.snapshot()
    with pytest.raises(ValueError, match=message):
        world.restore(state)
    assert world.snapshot() == before


def assert_value_refused(world: SimulatedWorld, name: str, value: float, message: str) -> None:
    """Assert the same for the world's own snapshot, with the first value of an array changed."""
    arrays = contents(world.snapshot())
    arrays[name].flat[0] = value
    assert_refused(world, packed(arrays), message)
