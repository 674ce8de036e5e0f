# SPDX-License-Identifier: Apache-2.0
"""How many threads the tensor library uses: one in flight, several to learn.

A batch of 256 observations is so little work that two threads wait for each other longer than
they compute.
"""
from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def tensor_threads(count: int) -> Iterator[None]:
    """Use so many threads within."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
