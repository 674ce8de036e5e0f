# SPDX-License-Identifier: Apache-2.0
"""Options that all experiments share."""
from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks.experiments.flights import Sample


class Options(NamedTuple):
    """Seeds, sizes and folders of an experiment."""

    seeds: Sequence[int]
    """Training seeds."""
    sample: Sample
    """Episodes and seed of the flights of each policy in each task."""
    runs: Path
    """Folder of the runs."""
    quick: bool
    """Whether to do as little as possible, to test only the program."""
