# SPDX-License-Identifier: Apache-2.0
"""Digest of a service's answer, by which its caller knows that it is the simulator's.

rclpy does not tell who sent an answer, and a second server of the same name answers as well. The
simulator therefore publishes this digest on `world`, whose sender is known, before it answers.
"""
from __future__ import annotations

import hashlib
import struct
from typing import Any

_NUMBERS = struct.Struct('<QBQQ')
_SIZE = 16
"""bytes"""


def answer_digest(agent: int, code: int, session: int, step: int, content: Any = b'') -> bytes:
    """Return the digest of an answer.

    :param agent: the caller.
    :param session: session of the answer, for snapshots that of the request; so is `step`.
    :param content: the buffer of `observation` or `state`.
    """
    found = hashlib.blake2b(_NUMBERS.pack(agent, code, session, step), digest_size=_SIZE)
    found.update(content)
    return found.digest()
