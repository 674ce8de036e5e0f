# SPDX-License-Identifier: Apache-2.0
"""Random streams of a training run: one for each purpose, derived from the run's seed.

A stream is a pure function of the seed and its purpose ('roll-out', iteration 12). So no generator
state has to be saved, and work that is repeated, after a restart of the simulator or of the
learner, draws the same numbers.
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

    It uses the lower 32 bits of the seed: with 20 000 streams, one run in twenty has two equal
    ones.
    """
    made = torch.Generator()
    made.manual_seed(derived_seed(seed, purpose, *index))
    return made
