# SPDX-License-Identifier: Apache-2.0
"""Statistics of finished episodes, in the form that Gymnasium's vector environments have them."""
from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.worlds import Episodes
from rocket_sim_node.worlds.base import F32

_SUCCESS = 0
"""Outcome that counts as a success: `landed` in all worlds."""
_COPIED = (
    'touchdown_speed', 'tilt', 'distance', 'fuel_used', 'fuel_left', 'hover_time', 'ignitions',
    'control_effort')
NAMES = ('episode_number', 'episode_return', 'episode_length', 'outcome', 'is_success', *_COPIED)
"""Names of the statistics of an episode; :class:`Episodes` says what they are, and their units.
`outcome` is an index of the world's outcomes, and `is_success` whether it is `landed`."""


def columns(episodes: Episodes) -> dict[str, NDArray[Any]]:
    """Return the statistics of K episodes by name, `(K,)` each."""
    return {
        'episode_number': episodes.episode, 'episode_return': episodes.episode_return,
        'episode_length': episodes.length, 'outcome': episodes.outcome.astype(np.int64),
        'is_success': episodes.outcome == _SUCCESS,
        **{name: getattr(episodes, name) for name in _COPIED}}


def dense(episodes: Episodes, num_envs: int) -> dict[str, Any]:
    """Return the statistics with one entry for each environment, `(N,)`, 0 where none ended.

    Beside each, under its name with `_` in front, is the mask `(N,)` of those that ended.
    """
    mask = np.zeros(num_envs, np.bool_)
    mask[episodes.row] = True
    found: dict[str, Any] = {}
    for name, values in columns(episodes).items():
        found[name] = np.zeros(num_envs, values.dtype)
        found[name][episodes.row] = values
        found[f'_{name}'] = mask.copy()
    return found


def final(episodes: Episodes, observation: F32, num_envs: int) -> dict[str, Any]:
    """Return `final_obs` and `final_info` of a step in which K episodes ended, and their masks.

    :param observation: `(K, D)` last observations of these episodes.
    """
    final_obs = np.full(num_envs, None, object)
    for row, last in zip(episodes.row.tolist(), observation, strict=True):
        final_obs[row] = last
    mask = np.zeros(num_envs, np.bool_)
    mask[episodes.row] = True
    return {
        'final_obs': final_obs, '_final_obs': mask,
        'final_info': dense(episodes, num_envs), '_final_info': mask.copy()}
