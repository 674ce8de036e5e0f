# SPDX-License-Identifier: Apache-2.0
"""Trained policies as files: the weights, and what they were trained for."""
from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from ppo_agent_node.learning import sealed_file
from ppo_agent_node.learning.networks import Policy
from ppo_agent_node.learning.networks import make_policy
from rocket_sim_node.worlds import WorldSpec

POLICY = 'policy'


def save_policy(
    path: Path,
    policy: Policy,
    spec: WorldSpec,
    hidden_sizes: tuple[int, ...],
    seed: int,
    training: dict[str, Any],
) -> None:
    """Write a policy and its description, atomically.

    :param training: a summary of how it came about, anything that JSON can say.
    :raises OSError: naming the path.
    """
    sealed_file.write(path, POLICY, policy.state_dict(), {
        'world': spec.name, 'observation_names': spec.observation_names,
        'action_names': spec.action_names, 'continuous': spec.continuous,
        'action_count': spec.action_count, 'hidden_sizes': hidden_sizes,
        'world_settings': spec.settings, 'seed': seed, 'training': training,
    })


def load_policy(path: Path, spec: WorldSpec) -> tuple[Policy, dict[str, Any]]:
    """Return a policy that fits a world, and its description.

    The world's name may be another, as long as observations and actions mean the same.

    :raises FileNotFoundError: when there is no such file.
    :raises ValueError: when it is damaged or does not fit; the message names the file, what was
        found and what was expected.
    """
    tensors, content = sealed_file.read(path, POLICY)
    for name, ours in (
        ('observation_names', list(spec.observation_names)),
        ('action_names', list(spec.action_names)),
        ('continuous', spec.continuous), ('action_count', spec.action_count),
    ):
        if content.get(name) != ours:
            raise ValueError(
                f'{path}: {name} of the policy, for world {content.get("world")!r}, is '
                f'{content.get(name)}, expected {ours} of world {spec.name!r}')
    sizes = content.get('hidden_sizes')
    if not isinstance(sizes, list) or not all(
            isinstance(size, int) and 0 < size <= 16_384 for size in sizes):
        raise ValueError(f'{path}: hidden_sizes is {sizes!r}, expected numbers of units')
    policy = make_policy(spec, sizes, torch.Generator())
    sealed_file.expect_tensors(path, tensors, policy.state_dict())
    policy.load_state_dict(tensors)
    return policy.eval(), content
