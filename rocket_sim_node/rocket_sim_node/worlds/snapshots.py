# SPDX-License-Identifier: Apache-2.0
"""Snapshots of a world as bytes: a NumPy archive that is checked before it is believed."""
from __future__ import annotations

import io
import zipfile
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import WorldSpec

Arrays = dict[str, NDArray[Any]]

# What NumPy and zipfile raise for damaged archives, a bare array (TypeError) and pickles included.
_UNREADABLE = (
    ValueError, TypeError, OSError, EOFError, KeyError, RuntimeError, NotImplementedError,
    zipfile.BadZipFile, zlib.error, MemoryError,
)

_LARGEST = 1e15
"""No state of a world comes near; sums of greater ones could end up infinite."""


def pack(spec: WorldSpec, arrays: Arrays) -> bytes:
    """Return the arrays as bytes that `unpack` takes."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, world=np.array(spec.name), **arrays)
    return buffer.getvalue()


def unpack(spec: WorldSpec, state: bytes, like: Arrays) -> Arrays:
    """Return the arrays in a snapshot, checked against those of a world of the same kind.

    :param like: arrays of the names, shapes and kinds that are expected.
    :raises ValueError: when the bytes are damaged, of another world or size, or not finite.
    """
    try:
        with np.load(io.BytesIO(state), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except _UNREADABLE as error:
        raise ValueError(f'snapshot: not readable, {len(state)} bytes: {error}') from error
    world = str(arrays.pop('world', '?'))
    if world != spec.name:
        raise ValueError(f'snapshot: of world {world!r}, expected {spec.name!r}')
    if set(arrays) != set(like):
        raise ValueError(f'snapshot: holds {sorted(arrays)}, expected {sorted(like)}')
    for name, expected in like.items():
        array = arrays[name]
        if array.shape != expected.shape or array.dtype != expected.dtype:
            raise ValueError(
                f'snapshot: {name} is {array.dtype} of shape {array.shape}, '
                f'expected {expected.dtype} of shape {expected.shape}'
            )
        if not np.isfinite(array).all():
            raise ValueError(f'snapshot: {name} has a value that is not finite')
        if array.dtype.kind == 'f' and (np.abs(array) > _LARGEST).any():
            raise ValueError(f'snapshot: {name} has a value beyond {_LARGEST:g}')
    return arrays


def check_settings(spec: WorldSpec, found: NDArray[np.float64]) -> None:
    """Check that a snapshot is of a world with the same constants.

    :param found: values in the order of `spec.settings`.
    :raises ValueError: naming the first that differs.
    """
    for (name, ours), its in zip(spec.settings.items(), found.tolist(), strict=True):
        if float(ours) != its:
            raise ValueError(f'snapshot: of a world with {name} {its:g}, expected {ours:g}')
