# SPDX-License-Identifier: Apache-2.0
"""Snapshots of a world as bytes: a NumPy archive that is validated before use."""
from __future__ import annotations

import io
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds.base import WorldSpec

Arrays = dict[str, NDArray[Any]]

# Errors of NumPy and zipfile for damaged archives and invalid array headers.
_UNREADABLE = (
    ValueError, TypeError, OSError, EOFError, KeyError, RuntimeError, NotImplementedError,
    OverflowError, MemoryError, SyntaxError, struct.error, tokenize.TokenError,
    zipfile.BadZipFile, zlib.error,
)

_LARGEST = 1e15
"""Far beyond any state of a world; sums of greater values could become infinite."""
_MOST = 2**62
"""Limit of steps or episodes, out of reach by counting."""


def pack(spec: WorldSpec, arrays: Arrays) -> bytes:
    """Return the arrays as bytes for `unpack`."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, world=np.array(spec.name), **arrays)
    return buffer.getvalue()


def unpack(
    spec: WorldSpec, state: bytes, like: Arrays, any_length: tuple[str, ...] = (),
    before: Mapping[str, NDArray[Any]] = MappingProxyType({}),
) -> Arrays:
    """Return the arrays in a snapshot, checked against those of a world of the same kind.

    :param like: arrays with the expected names, shapes and types.
    :param any_length: names of arrays whose length may differ.
    :param before: values of arrays that older snapshots do not have.
    :raises ValueError: when the bytes are damaged, of another world or size, or not finite.
    """
    if not hasattr(state, '__len__'):
        raise ValueError(f'snapshot: got {state!r:.80}, expected bytes')
    try:
        arrays = _arrays(state)
    except _UNREADABLE as error:
        raise ValueError(f'snapshot: not readable, {len(state)} bytes: {error}') from error
    world = str(arrays.pop('world', '?'))
    if world != spec.name:
        raise ValueError(f'snapshot: of world {world!r}, expected {spec.name!r}')
    held = sorted(arrays)
    arrays = {**before, **arrays}
    if set(arrays) != set(like):
        raise ValueError(f'snapshot: holds {held}, expected {sorted(like)}')
    for name, expected in like.items():
        array = arrays[name]
        shape = expected.shape
        if name in any_length and array.ndim:
            shape = (len(array), *shape[1:])
        if array.shape != shape or array.dtype != expected.dtype:
            raise ValueError(
                f'snapshot: {name} is {array.dtype} of shape {array.shape}, '
                f'expected {expected.dtype} of shape {expected.shape}'
            )
        if not np.isfinite(array).all():
            raise ValueError(f'snapshot: {name} has a value that is not finite')
        if array.dtype.kind == 'f' and (np.abs(array) > _LARGEST).any():
            raise ValueError(f'snapshot: {name} has a value beyond {_LARGEST:g}')
    return arrays


def zeros(arrays: Arrays) -> Arrays:
    """Return arrays of zeros, for `before`."""
    return {name: np.zeros_like(array) for name, array in arrays.items()}


def check_counts(arrays: Arrays, *names: str) -> None:
    """Check counters; not for seeds, which may be the largest integer.

    :raises ValueError: naming the array.
    """
    for name in names:
        if (arrays[name] < 0).any():
            raise ValueError(f'snapshot: {name} has a value below 0')
        if name != 'seed' and (arrays[name] > _MOST).any():
            raise ValueError(f'snapshot: {name} has a value beyond {_MOST}')


def check_range(arrays: Arrays, low: float, high: float, *names: str) -> None:
    """Check values whose bounds hold in every world.

    :raises ValueError: naming the array.
    """
    for name in names:
        if ((arrays[name] < low) | (arrays[name] > high)).any():
            raise ValueError(f'snapshot: {name} has a value outside {low:g} to {high:g}')


def _arrays(state: bytes) -> Arrays:
    """Return the arrays of an archive of `numpy.savez`.

    NumPy's own reader would decompress data and allocate what a header promises before any check:
    a few bytes could exhaust memory. Here an array is no larger than the bytes of its entry.

    :raises Exception: one of `_UNREADABLE`.
    """
    arrays: Arrays = {}
    with zipfile.ZipFile(io.BytesIO(state)) as archive:
        entries = archive.infolist()
        # A damaged directory may hide entries; the number of all is at the archive's end.
        if len(entries) != int.from_bytes(state[-12:-10], 'little'):
            raise ValueError('its directory is damaged')
        if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries) or (
                sum(entry.file_size for entry in entries) > len(state)):
            raise ValueError('its entries are compressed or larger than the file')
        for entry in entries:
            name = entry.filename.removesuffix('.npy')
            if name in arrays:
                raise ValueError(f'holds {name!r} twice')
            data = archive.read(entry)
            stream = io.BytesIO(data)
            if np.lib.format.read_magic(stream) != (1, 0):
                raise ValueError(f'{name!r} is not an array of format 1.0')
            shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
            if dtype.hasobject:
                raise ValueError(f'{name!r} holds objects, expected numbers')
            flat = np.frombuffer(data, dtype, offset=stream.tell())
            arrays[name] = flat.reshape(shape, order='F' if fortran else 'C').copy()
    return arrays


def check_settings(settings: Mapping[str, float], found: NDArray[np.float64]) -> None:
    """Check that a snapshot is of a world with the same constants.

    :param settings: those of this world.
    :param found: values in the same order.
    :raises ValueError: naming the first that differs.
    """
    for (name, ours), its in zip(settings.items(), found.tolist(), strict=True):
        if float(ours) != its:
            raise ValueError(f'snapshot: of a world with {name} {its:g}, expected {ours:g}')
