# SPDX-License-Identifier: Apache-2.0
"""Starts below the usual height, by which a reverse curriculum begins: setting `spawn_reach`."""
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds import random_streams
from rocket_sim_node.worlds.base import F64

_HEIGHTS = 2**33
"""Index of the random stream that draws an episode's height."""


def reach_share(
    seed: int, row: NDArray[np.integer], episode: NDArray[np.integer],
) -> F64:
    """Return start heights as a fraction of `spawn_reach`, `(K,)`, uniform in (0, 1].

    The fraction does not depend on the reach. So a learner, which knows the seed of its reset, can
    tell hard starts from easy ones without inferring it from observations.

    :param row: `(K,)` vehicles.
    :param episode: `(K,)` their episodes.
    """
    share: F64 = 0.5 - 0.5 * random_streams.uniform(seed, row, episode, 1, _HEIGHTS)[0]
    return share
