# SPDX-License-Identifier: Apache-2.0
"""The pilot that a training run made: flies what the policy thinks best, without noise."""
from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppo_agent_node.ppo.policies.factory import without_noise
from ppo_agent_node.ppo.policies.file import load_policy
from rocket_sim_node import worlds
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.base import F32


class PolicyPilot:
    """Flies a policy file in a world that it fits. A `Pilot`."""

    name = 'policy'

    def __init__(self, path: Path | str, spec: WorldSpec) -> None:
        """Load the policy.

        Where the world gives more observations than the policy sees, the policy is shown its own
        columns of them.

        :raises FileNotFoundError: when there is no such file.
        :raises ValueError: when it is damaged, has weights that are not finite, or was made for
            other observations or actions than `spec` has; the message names file and difference.
        """
        policy, self.description = load_policy(Path(path), spec)
        self._fly = without_noise(policy)
        self._columns = columns(self.description['observation_names'], spec.observation_names)
        self.unfamiliar = _unfamiliar(Path(path), self.description, spec)
        """in what the world differs from the one that it was trained in, empty when in nothing"""

    def __call__(self, observation: F32) -> NDArray[Any]:
        """Return the actions for observations `(N, D)`: `(N, A)` float32, or `(N,)` discrete."""
        if self._columns is not None:
            # Contiguous, as alone: another layout might be summed in another order.
            observation = np.ascontiguousarray(observation[:, self._columns])
        return self._fly(observation)


def columns(wanted: Sequence[str], given: Sequence[str]) -> slice | list[int] | None:
    """Return where the wanted observations stand among the given ones; None: they are the same.

    :raises ValueError: when one is not among them.
    """
    if list(wanted) == list(given):
        return None
    places = [list(given).index(name) for name in wanted]
    first = places[0]
    if places == list(range(first, first + len(places))):
        return slice(first, first + len(places))
    return places


def _unfamiliar(path: Path, description: dict[str, Any], spec: WorldSpec) -> str:
    """Return what to say of a world that is set up otherwise than in training.

    Where its episodes begin is the curriculum's and is left out, and so are conditions, which are
    there to be met, and other worlds.
    """
    trained = description.get('world_settings')
    if description.get('world') != spec.name or not isinstance(trained, dict):
        return ''
    free = set(worlds.reset_settings(spec.name)) if spec.name in worlds.names() else set()
    free.add('observation')  # what is not the policy's it is not shown
    differences = [
        f'{name} {trained[name]!s:.40}, here {value:g}' for name, value in spec.settings.items()
        if name in trained and name not in free and trained[name] != value]
    return f'{path} was trained with {"; ".join(differences)}' if differences else ''
