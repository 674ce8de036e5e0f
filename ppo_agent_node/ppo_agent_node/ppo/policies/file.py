# SPDX-License-Identifier: Apache-2.0
"""Policy files: the weights and a description of what they were trained for."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from ppo_agent_node.config.training_config import NetworkConfig
from ppo_agent_node.ppo.policies.factory import Policy
from ppo_agent_node.ppo.policies.factory import make_policy
from ppo_agent_node.runs import sealed_file
from ppo_agent_node.runs.sealed_file import Tensors
from rocket_sim_node import settings
from rocket_sim_node.worlds import WorldSpec

POLICY = 'policy'
_NEEDED = (
    'observation_names', 'action_names', 'continuous', 'action_count', 'hidden_sizes')
"""Required entries of a policy's description."""


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
    sealed_file.write(path, POLICY, policy.state_dict(), {
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
    tensors, content = sealed_file.read(path, POLICY)
    for name in _NEEDED:
        if name not in content:
            raise ValueError(
                f'{path}: {name} of the policy is not there, expected {", ".join(_NEEDED)}')
    spec = _narrowed(path, spec, content['observation_names'])
    for name, ours in (
        ('observation_names', list(spec.observation_names)),
        ('action_names', list(spec.action_names)),
        ('continuous', spec.continuous), ('action_count', spec.action_count),
    ):
        if content[name] != ours:
            raise ValueError(
                f'{path}: {name} of the policy, for world '
                f'{_short(content.get("world", "unknown"))!r}, is {_short(content[name])}, '
                f'expected {ours} of world {spec.name!r}')
    network = _network(path, content)
    _expect_room(path, tensors, network, spec)
    policy = make_policy(spec, network, torch.Generator())
    sealed_file.expect_tensors(path, tensors, policy.state_dict())
    policy.load_state_dict(tensors)
    return policy.eval(), content


def _narrowed(path: Path, spec: WorldSpec, names: object) -> WorldSpec:
    """Return a world reduced to the observations that a policy names, if it has them all.

    :raises ValueError: for a policy that needs other observations than the world's.
    """
    given = spec.observation_names
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        return spec
    missing = [name for name in names if name not in given]
    if not missing and names and len(set(names)) == len(names):
        return replace(spec, observation_names=tuple(names))
    if missing and set(given) < set(names):
        raise ValueError(
            f'{path}: observation_names: the policy also sees {_listed(missing)}; expected a '
            f'world {spec.name!r} that gives them, as with observation:=extended')
    return spec


def _listed(names: Sequence[str], most: int = 3) -> str:
    """Return the first few names as text, and the number of the others."""
    more = f' and {len(names) - most} more' if len(names) > most else ''
    return ', '.join(f'{name:.40}' for name in names[:most]) + more


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
            f'{path}: hidden_sizes {_short(network.hidden_sizes)}: need {needed} weights, '
            f'expected no more than the {held} in its {len(tensors)} tensors')


def _short(value: object) -> str:
    return f'{value!s:.200}'


def _network(path: Path, content: dict[str, Any]) -> NetworkConfig:
    """Return the shape of the network; older files have neither activation nor features."""
    try:
        return settings.build(NetworkConfig, {
            'hidden_sizes': content['hidden_sizes'],
            'activation': content.get('activation', 'tanh'),
            'features': content.get('features', 'none')})
    except (ValueError, TypeError) as error:
        raise ValueError(f'{path}: {error}') from error
