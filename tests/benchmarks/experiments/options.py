# SPDX-License-Identifier: Apache-2.0
"""What all experiments can be told."""
from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks.experiments.flights import Sample


class Options(NamedTuple):
    """Seeds, sizes and folders of an experiment."""

    seeds: Sequence[int]
    """of the trainings"""
    sample: Sample
    """what each policy flies of each task"""
    runs: Path
    """folder of the runs"""
    quick: bool
    """so little of everything that only the program is tried"""
