# SPDX-License-Identifier: Apache-2.0
"""Failed episodes of an evaluation, listed so that they can be flown again."""
from __future__ import annotations

from typing import Any

import numpy as np

from ppo_agent_node.evaluation.runner import EvaluationResult

MOST = 12
"""Maximum number of listed episodes."""


def failed_starts(result: EvaluationResult) -> list[dict[str, Any]]:
    """Return the first failed episodes: one of each outcome, then a second of each, and so on.

    Row and episode determine the start, together with the seed and the settings. Low episode
    numbers come first, as flying one again requires the episodes before it.
    """
    flown = result.episodes
    failed = np.flatnonzero(~result.landed)
    failed = failed[np.lexsort((flown.row[failed], flown.episode[failed]))]
    outcome = flown.outcome[failed]
    turn = np.zeros(len(failed), np.int64)
    for code in np.unique(outcome):
        same = outcome == code
        turn[same] = np.arange(np.count_nonzero(same))
    chosen = failed[np.argsort(turn, kind='stable')[:MOST]]
    return [
        {'row': int(flown.row[place]), 'episode': int(flown.episode[place]),
         'outcome': result.spec.outcomes[flown.outcome[place]],
         'return': float(flown.episode_return[place])} for place in chosen.tolist()]
