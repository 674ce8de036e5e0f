# SPDX-License-Identifier: Apache-2.0
"""Flying quality beyond the landing rate: empty tanks, hovering, ignitions, control effort."""
from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ppo_agent_node.evaluation.averages import mean
from ppo_agent_node.evaluation.averages import spread
from ppo_agent_node.evaluation.runner import EvaluationResult
from ppo_agent_node.statistics import wilson


def figures(result: EvaluationResult) -> dict[str, Any]:
    """Return the figures, null in worlds without rockets."""
    dry, episodes = result.dry, result.episodes
    if dry is None:
        none = spread(np.zeros(0))
        return {'tanks_dry': None, 'tanks_dry_interval': None, 'mean_return_tanks_dry': None,
                'hover_time': none, 'ignitions': none, 'control_effort': none}
    count = int(dry.sum())
    return {
        'tanks_dry': count / len(dry),
        'tanks_dry_interval': list(wilson(count, len(dry))),
        'mean_return_tanks_dry': mean(episodes.episode_return[dry]),
        'hover_time': spread(episodes.hover_time),
        'ignitions': spread(episodes.ignitions.astype(np.float64)),
        'control_effort': spread(episodes.control_effort),
    }


def rows(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return them as rows of the terminal's table, none in worlds without rockets."""
    if summary['tanks_dry'] is None:
        return []
    low, high = (100 * bound for bound in summary['tanks_dry_interval'])
    hover, lit, effort = (summary[name] for name in ('hover_time', 'ignitions', 'control_effort'))
    return [
        ('tanks dry', f'{100 * summary["tanks_dry"]:.2f} %  [{low:.2f}, {high:.2f}]'),
        ('hovering', f'{hover["mean"]:.3g} s  (95 %: below {hover["p95"]:.3g})'),
        ('ignitions', f'{lit["mean"]:.4g}  (95 %: at most {lit["p95"]:.4g})'),
        ('control effort',
         f'{effort["mean"]:.3g} a step  (95 %: below {effort["p95"]:.3g})'),
    ]
