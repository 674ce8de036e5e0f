# SPDX-License-Identifier: Apache-2.0
"""Invalid data of all kinds: strategies for hypothesis, and damage to valid bytes."""
from __future__ import annotations

import io
import struct
import zipfile
from typing import Any

import numpy as np
from hypothesis import strategies as st

ANY_U64 = st.one_of(st.sampled_from([0, 1, 2**31, 2**63, 2**64 - 1]), st.integers(0, 2**64 - 1))
ANY_I64 = st.one_of(
    st.sampled_from([-2**63, -2, -1, 0, 2**62, 2**63 - 1]), st.integers(-2**63, 2**63 - 1))
ANY_FLOAT = st.floats(allow_nan=True, allow_infinity=True)
ANY_F32 = st.floats(width=32, allow_nan=True, allow_infinity=True)
ANY_BYTES = st.binary(max_size=200)
WIRE_TEXT = st.binary(max_size=30).map(lambda data: data.decode(errors='replace'))
"""strings as rosidl decodes them from arbitrary bytes"""
DAMAGES = ('truncate', 'flip', 'insert', 'remove', 'double', 'counts')


def damaged(data: bytes, rng: np.random.Generator, how: str) -> bytes:
    """Return valid bytes with one kind of damage at a random place."""
    place = int(rng.integers(len(data) + 1))
    some = rng.bytes(int(rng.integers(1, 9)))
    if how == 'truncate':
        return data[:place]
    if how == 'flip':
        place = int(rng.integers(len(data)))
        return data[:place] + bytes([data[place] ^ int(rng.integers(1, 256))]) + data[place + 1:]
    if how == 'insert':
        return data[:place] + some + data[place:]
    if how == 'remove':
        return data[:place] + data[place + len(some):]
    if how == 'double':
        return data[:place] + data[max(place - 40, 0):]
    count = struct.pack('<I', int(rng.choice([2**32 - 1, 2**31, 2**31 - 1, 2**16])))
    return data[:place] + count + data[place + 4:]


@st.composite
def damage(draw: Any, data: bytes) -> bytes:
    """Strategy for damaged copies of valid bytes."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    for how in draw(st.lists(st.sampled_from(DAMAGES), min_size=1, max_size=3)):
        data = damaged(data or b'\0', rng, how)
    return data


def npy(header: str, data: bytes = b'') -> bytes:
    """Return the bytes of an array file with an arbitrary header."""
    text = header.encode('latin1')
    return b'\x93NUMPY\x01\x00' + struct.pack('<H', len(text)) + text + data


def archive(
    entries: list[tuple[str, bytes]], compression: int = zipfile.ZIP_STORED,
) -> bytes:
    """Return a zip archive with arbitrary entries, duplicates included."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, 'w', compression) as file:
        for name, data in entries:
            file.writestr(zipfile.ZipInfo(name), data, compression)
    return buffer.getvalue()


