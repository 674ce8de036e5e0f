# SPDX-License-Identifier: Apache-2.0
"""What `bench seeds` says of several training seeds together."""
from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from benchmarks.learning.seeds import of_all_seeds


def flown(*returns: float) -> Any:
    """Return flights with these returns."""
    return SimpleNamespace(episodes=SimpleNamespace(episode_return=np.array(returns)))


def test_the_gain_is_that_of_paired_starts(capsys: pytest.CaptureFixture[str]) -> None:
    found = of_all_seeds('mix:7', [
        (flown(1.0, 100.0), flown(2.0, 101.0)), (flown(50.0, 3.0), flown(53.0, 6.0))])
    assert (found['clones'], found['policies'], found['gain']) == (38.5, 40.5, 2.0)
    # Over the seeds, PPO gains 2 from either start.
    assert found['gain_interval'] == (2.0, 2.0)
    # Two seeds: Student's factor is 12.7, times the standard error of 1.
    assert found['gain_interval_over_seeds'] == pytest.approx((-10.706, 14.706), abs=1e-3)
    assert '2 seeds together, mix:7: clones 38.500 [' in capsys.readouterr().out
