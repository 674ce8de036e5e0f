# SPDX-License-Identifier: Apache-2.0
"""Pilot that flies a trained policy, deterministically: a policy file or an ONNX file."""
from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppo_agent_node.pilots import onnx_file
from ppo_agent_node.pilots.search import require_torch
from rocket_sim_node import worlds
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.base import F32


class PolicyPilot:
    """Flies a policy file in a world that it fits. A `Pilot`."""

    name = 'policy'

    def __init__(self, path: Path | str, spec: WorldSpec, device: str = 'cpu') -> None:
        """Load the policy; an ONNX file needs onnxruntime, and no PyTorch.

        If the world has more observations than the policy uses, the policy receives its own
        columns of them.

        :param device: where the actions of a policy file are computed: `cpu`, `cuda`, or `auto`
            for the GPU if there is one. An ONNX file uses the CPU.
        :raises FileNotFoundError: when there is no such file.
        :raises ValueError: when it is damaged, has weights that are not finite, or was trained for
            other observations or actions than those of `spec`; the message names file and
            difference. For an unknown device, or one that is not available.
        """
        path = Path(path)
        if path.suffix != onnx_file.SUFFIX:
            self._fly, self.description = _load(path, spec, device)
        elif device not in ('cpu', 'auto'):
            raise ValueError(f"device: got {device!r}, expected 'cpu' or 'auto' for {path}")
        else:
            self._fly, self.description = onnx_file.load(path, spec)
        self._columns = columns(self.description['observation_names'], spec.observation_names)
        self.unfamiliar = _unfamiliar(path, self.description, spec)
        """Differences between this world and that of the training; empty if there are none."""

    def __call__(self, observation: F32) -> NDArray[Any]:
        """Return the actions for observations `(N, D)`: `(N, A)` float32, or `(N,)` discrete.

        Continuous actions are within their bounds.
        """
        if self._columns is not None:
            # Contiguous: another memory layout might change the order of summation.
            observation = np.ascontiguousarray(observation[:, self._columns])
        return self._fly(observation)


def _load(path: Path, spec: WorldSpec, device: str) -> tuple[onnx_file.Fly, dict[str, Any]]:
    """Return a pilot of the policy in a safetensors file, and its description."""
    require_torch(path)
    # Imported here: a machine that flies ONNX files may lack PyTorch.
    from ppo_agent_node.devices import find_device
    from ppo_agent_node.ppo.policies.factory import without_noise
    from ppo_agent_node.ppo.policies.file import load_policy

    policy, description = load_policy(path, spec)
    mean = without_noise(policy.to(find_device(device)))
    if not spec.continuous:
        return mean, description
    # The world would clip them as well, and report each of them in real time. NaN stays NaN.
    low, high = (np.asarray(bound, np.float32) for bound in (spec.action_low, spec.action_high))
    return lambda observation: np.clip(mean(observation), low, high), description


def columns(wanted: Sequence[str], given: Sequence[str]) -> slice | list[int] | None:
    """Return the indices of the wanted observations among the given ones; None: identical.

    :raises ValueError: when one is missing.
    """
    if list(wanted) == list(given):
        return None
    places = [list(given).index(name) for name in wanted]
    first = places[0]
    if places == list(range(first, first + len(places))):
        return slice(first, first + len(places))
    return places


def _unfamiliar(path: Path, description: dict[str, Any], spec: WorldSpec) -> str:
    """Return a warning about a world that is set up differently than in training.

    Spawn settings are ignored, as the curriculum varies them; so are conditions, which a policy is
    expected to handle, and other worlds.
    """
    trained = description.get('world_settings')
    if description.get('world') != spec.name or not isinstance(trained, dict):
        return ''
    free = set(worlds.reset_settings(spec.name)) if spec.name in worlds.names() else set()
    free.add('observation')  # the policy does not receive other observations
    differences = [
        f'{name} {trained[name]!s:.40}, here {value:g}' for name, value in spec.settings.items()
        if name in trained and name not in free and trained[name] != value]
    return f'{path} was trained with {"; ".join(differences)}' if differences else ''
