# SPDX-License-Identifier: Apache-2.0
"""Snapshots taken apart and put together again, as a forger would."""
from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray


def contents(state: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays in a snapshot."""
    with np.load(io.BytesIO(state)) as archive:
        return dict(archive)


def packed(arrays: dict[str, Any]) -> bytes:
    """Return arrays as bytes, as a forger would."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()
