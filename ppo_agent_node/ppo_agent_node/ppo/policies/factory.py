# SPDX-License-Identifier: Apache-2.0
"""Creation of the policy that fits a world's kind of action."""
from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ppo_agent_node.config.training_config import NetworkConfig
from ppo_agent_node.ppo.networks.features import feature_names
from ppo_agent_node.ppo.networks.features import make_features
from ppo_agent_node.ppo.networks.symmetry import Symmetry
from ppo_agent_node.ppo.networks.symmetry import make_symmetry
from ppo_agent_node.ppo.policies.base import Policy as Policy
from ppo_agent_node.ppo.policies.categorical import CategoricalPolicy as CategoricalPolicy
from ppo_agent_node.ppo.policies.gaussian import GaussianPolicy as GaussianPolicy
from ppo_agent_node.threads import tensor_threads
from rocket_sim_node.worlds import WorldSpec


def without_noise(policy: Policy) -> Callable[[NDArray[np.float32]], NDArray[Any]]:
    """Return a deterministic pilot, in NumPy, that takes the policy's most likely action.

    It computes on the policy's device. See `quick` for what it takes from the policy now, and what
    later.
    """
    outputs = policy.quick_output()
    device = policy.normaliser.mean.device

    @torch.inference_mode()
    def fly(observation: NDArray[np.float32]) -> NDArray[Any]:
        # A script that imports torch before this package has as many threads as cores.
        with tensor_threads(1):
            action: NDArray[Any] = policy.most_likely(
                outputs(torch.tensor(observation, device=device))).cpu().numpy()
        return action

    return fly


def symmetry_of(spec: WorldSpec, network: NetworkConfig) -> Symmetry | None:
    """Return the symmetries that the networks of a world shall have."""
    return make_symmetry(
        network.symmetry, spec.observation_names, feature_names(network.features),
        spec.action_names, spec.action_count)


def make_policy(spec: WorldSpec, network: NetworkConfig, generator: torch.Generator) -> Policy:
    """Return a policy for a world's kind of action.

    :param network: its shape; settings of the noise apply to continuous actions only.
    :raises ValueError: for features that cannot be computed from the world's observations.
    """
    features = make_features(network.features, spec.observation_names, spec.settings)
    if not spec.continuous:
        return CategoricalPolicy(
            spec.observation_size, spec.action_count, network.hidden_sizes, generator,
            network.activation, symmetry_of(spec, network))
    return GaussianPolicy(
        spec.observation_size, spec.action_size, network.hidden_sizes, generator,
        network.log_std_init, network.log_std_final, network.log_std_floor, network.activation,
        features, symmetry_of(spec, network), network.exploration)
