# SPDX-License-Identifier: Apache-2.0
"""Random numbers of a training run: one stream for each purpose, derived from the run's seed.

A stream is a pure function of the seed and of what it is for ('roll-out', iteration 12), so that
no generator state has to be saved, and a piece of work that is begun again, after a restart of
the simulator or of the learner, draws the same numbers.
"""
from __future__ import annotations

import zlib

import numpy as np
import torch


def derived_seed(seed: int, purpose: str, *index: int) -> int:
    """Return a seed from 0 to 2**63 - 1 for one purpose of a run.

    Mixed by NumPy's SeedSequence (O'Neill, 'PCG: a family of better random number generators',
    2014, and numpy.org/doc/stable/reference/random/bit_generators).
    """
    words = [seed, zlib.crc32(purpose.encode()), *index]
    low, high = np.random.SeedSequence(words).generate_state(2, np.uint64)
    return int((low ^ (high << np.uint64(1))) >> np.uint64(1))


def generator(seed: int, purpose: str, *index: int) -> torch.Generator:
    """Return a torch generator at the start of one purpose's stream.

    It takes the lower 32 bits of the seed: of 20 000 streams two are alike in one run of twenty.
    """
    made = torch.Generator()
    made.manual_seed(derived_seed(seed, purpose, *index))
    return made
