# SPDX-License-Identifier: Apache-2.0
"""Errors that the libraries raise for files that are cut short or damaged."""
from __future__ import annotations

import struct

from mcap.exceptions import McapError
from zstandard import ZstdError

DAMAGED: tuple[type[Exception], ...] = (
    McapError, ValueError, EOFError, LookupError, MemoryError, OverflowError, struct.error,
    ZstdError)
"""Errors of mcap and zstandard that mean a damaged file."""
