# SPDX-License-Identifier: Apache-2.0
"""Policy files: the weights and a description of what they were trained for."""
from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from ppo_agent_node.config.training_config import NetworkConfig
from ppo_agent_node.ppo.policies.compatibility import fitted
from ppo_agent_node.ppo.policies.compatibility import short
from ppo_agent_node.ppo.policies.factory import Policy
from ppo_agent_node.ppo.policies.factory import make_policy
from ppo_agent_node.runs import tensor_file
from ppo_agent_node.runs.tensor_file import Tensors
from rocket_sim_node import settings
from rocket_sim_node.worlds import WorldSpec

POLICY = 'policy'


def save_policy(
    path: Path,
    policy: Policy,
    spec: WorldSpec,
    network: NetworkConfig,
    seed: int,
    training: dict[str, Any],
) -> None:
    """Write a policy and its description, atomically.

    :param training: a JSON-serialisable summary of its training.
    :raises OSError: naming the path.
    """
    tensor_file.write(path, POLICY, policy.state_dict(), {
        'world': spec.name, 'observation_names': spec.observation_names,
        'action_names': spec.action_names, 'continuous': spec.continuous,
        'action_count': spec.action_count, 'hidden_sizes': network.hidden_sizes,
        'activation': network.activation, 'features': network.features,
        'world_settings': spec.settings, 'seed': seed,
        'training': training,
    })


def load_policy(path: Path, spec: WorldSpec) -> tuple[Policy, dict[str, Any]]:
    """Return a policy that fits a world, and its description.

    The world's name may differ, as long as observations and actions mean the same. The world
    may have more observations than the policy uses; the policy takes those that the description
    names, in that order.

    :raises FileNotFoundError: when there is no such file.
    :raises ValueError: when it is damaged or does not fit; the message names the file, and the
        actual and expected values.
    """
    tensors, content = tensor_file.read(path, POLICY)
    spec = fitted(path, content, spec, ('hidden_sizes',))
    network = _network(path, content)
    _expect_room(path, tensors, network, spec)
    policy = make_policy(spec, network, torch.Generator())
    tensor_file.expect_tensors(path, tensors, policy.state_dict())
    policy.load_state_dict(tensors)
    return policy.eval(), content


def _expect_room(
    path: Path, tensors: Tensors, network: NetworkConfig, spec: WorldSpec,
) -> None:
    """Check that a network is no larger than its file, before it is created.

    :raises ValueError: naming the file and the sizes of the layers.
    """
    sizes = (spec.observation_size, *network.hidden_sizes)
    needed = sum(a * b for a, b in zip(sizes, sizes[1:], strict=False))
    held = sum(tensor.numel() for tensor in tensors.values())
    if needed > held or len(network.hidden_sizes) > len(tensors):
        raise ValueError(
            f'{path}: hidden_sizes {short(network.hidden_sizes)}: need {needed} weights, '
            f'expected no more than the {held} in its {len(tensors)} tensors')


def _network(path: Path, content: dict[str, Any]) -> NetworkConfig:
    """Return the shape of the network; older files have neither activation nor features."""
    try:
        return settings.build(NetworkConfig, {
            'hidden_sizes': content['hidden_sizes'],
            'activation': content.get('activation', 'tanh'),
            'features': content.get('features', 'none')})
    except (ValueError, TypeError) as error:
        raise ValueError(f'{path}: {error}') from error
