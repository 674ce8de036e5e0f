# SPDX-License-Identifier: Apache-2.0
"""Error of a run of several processes; imports nothing, as nodes without PyTorch need it."""
from __future__ import annotations


class RankLost(RuntimeError):
    """Another rank of the run has ended or cannot be reached: the run must be resumed."""
