# SPDX-License-Identifier: Apache-2.0
"""The codec of messages writes and reads the same bytes as rosidl."""
from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from rclpy.serialization import serialize_message
from rocket_msgs import msg

from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.wire.messages.cdr import Codec

KINDS = (msg.Action, msg.Observation, msg.Reward, msg.Episodes)
CODES = {'sequence<float>': 'f4', 'sequence<double>': 'f8', 'sequence<int32>': 'i4',
         'sequence<uint8>': 'u1', 'sequence<uint32>': 'u4', 'sequence<uint64>': 'u8'}


def random_message(kind: Any, rng: np.random.Generator) -> tuple[Any, list[int], list[Any]]:
    """Return a message with sequences of random lengths, none included, and what is in it."""
    message, numbers, arrays = kind(), [], []
    for name, text in kind.get_fields_and_field_types().items():
        if text == 'uint64':
            numbers.append(int(rng.integers(2**63)))
            setattr(message, name, numbers[-1])
        else:
            values = rng.integers(0, 200, rng.integers(0, 6)).astype(CODES[text])
            arrays.append(values)
            setattr(message, name, conversion.to_sequence(values, CODES[text]))
    return message, numbers, arrays


@pytest.mark.parametrize('kind', KINDS)
def test_messages_are_encoded_and_decoded_as_by_rosidl(kind: Any) -> None:
    codec, rng = Codec(kind), np.random.default_rng(1)
    for _ in range(200):
        message, numbers, arrays = random_message(kind, rng)
        assert deserialize_message(codec.encode(numbers, arrays), kind) == message
        read = codec.decode(bytes(serialize_message(message)))
        assert list(read[:len(numbers)]) == numbers
        for ours, theirs in zip(read[len(numbers):], arrays, strict=True):
            assert ours.dtype == theirs.dtype
            np.testing.assert_array_equal(ours, theirs)


def test_bytes_of_another_order_are_read() -> None:
    message = msg.Observation(session=1, step=2)
    message.data = conversion.to_sequence(np.array([1.5, 2.5]), 'f4')
    big = (b'\x00\x00\x00\x00' + (1).to_bytes(8, 'big') + (2).to_bytes(8, 'big')
           + (2).to_bytes(4, 'big') + np.array([1.5, 2.5], '>f4').tobytes())
    read = Codec(msg.Observation).decode(big)
    assert (read.session, read.step, read.data.tolist()) == (1, 2, [1.5, 2.5])


@pytest.mark.parametrize('kind', KINDS)
def test_truncated_messages_are_refused(kind: Any) -> None:
    codec = Codec(kind)
    _, numbers, arrays = random_message(kind, np.random.default_rng(3))
    whole = codec.encode(numbers, [np.ones(3, a.dtype) for a in arrays])
    for length in range(len(whole)):
        with pytest.raises(ValueError, match=f'cut short: {length} bytes'):
            codec.decode(whole[:length])


def test_lengths_beyond_the_bytes_are_refused() -> None:
    codec = Codec(msg.Observation)
    whole = bytearray(codec.encode((1, 2), (np.zeros(4),)))
    whole[20:24] = (0xFFFFFFFF).to_bytes(4, 'little')
    with pytest.raises(ValueError, match='cut short'):
        codec.decode(bytes(whole))


def test_messages_with_text_fields_are_refused() -> None:
    with pytest.raises(ValueError, match='World: world is string, expected numbers'):
        Codec(msg.World)
