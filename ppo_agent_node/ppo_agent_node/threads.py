# SPDX-License-Identifier: Apache-2.0
"""Number of threads of the tensor library: one in flight, several for learning.

A batch of 256 observations is so little work that two threads would wait for each other longer
than they compute.
"""
from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def tensor_threads(count: int) -> Iterator[None]:
    """Use `count` threads within the context."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
