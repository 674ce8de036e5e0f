# SPDX-License-Identifier: Apache-2.0
"""Whether a policy fits a world, by its description alone: needs neither weights nor PyTorch."""
from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rocket_sim_node.worlds import WorldSpec

_NEEDED = ('observation_names', 'action_names', 'continuous', 'action_count')
"""Required entries of a policy's description."""


def fitted(
    path: Path, content: Mapping[str, Any], spec: WorldSpec, needed: Sequence[str] = (),
) -> WorldSpec:
    """Return a world reduced to the observations of a policy, in the policy's order.

    The world's name may differ, as long as observations and actions mean the same.

    :param content: the description of the policy.
    :param needed: entries that it must have beside those that say what it fits.
    :raises ValueError: when it does not fit; the message names the file, and the actual and
        expected values.
    """
    needed = (*_NEEDED, *needed)
    for name in needed:
        if name not in content:
            raise ValueError(
                f'{path}: the policy has no {name}, expected {", ".join(needed)}')
    spec = _narrowed(path, spec, content['observation_names'])
    for name, ours in (
        ('observation_names', list(spec.observation_names)),
        ('action_names', list(spec.action_names)),
        ('continuous', spec.continuous), ('action_count', spec.action_count),
    ):
        if content[name] != ours:
            raise ValueError(
                f'{path}: {name} of the policy: got {short(content[name])} (world '
                f'{short(content.get("world", "unknown"))!r}), expected {ours} (world '
                f'{spec.name!r})')
    return spec


def short(value: object) -> str:
    """Return a value of a file as text of at most 200 characters."""
    return f'{value!s:.200}'


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
            f'world {spec.name!r} that observes them, for instance with observation:=extended')
    return spec


def _listed(names: Sequence[str], most: int = 3) -> str:
    """Return the first few names as text, and the number of the others."""
    more = f' and {len(names) - most} more' if len(names) > most else ''
    return ', '.join(f'{name:.40}' for name in names[:most]) + more
