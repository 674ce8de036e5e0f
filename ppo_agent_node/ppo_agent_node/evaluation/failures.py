# SPDX-License-Identifier: Apache-2.0
"""Which episodes of an evaluation failed, so that they can be flown again."""
from __future__ import annotations

from typing import Any

import numpy as np

from ppo_agent_node.evaluation.runner import EvaluationResult

MOST = 12
"""episodes that are named"""


def failed_starts(result: EvaluationResult) -> list[dict[str, Any]]:
    """Return the first that did not land: one of each outcome, then a second of each, and so on.

    Row and episode decide the start, together with the seed and the settings. Low numbers of
    episodes come first: to fly one again takes those before it.
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
