# SPDX-License-Identifier: Apache-2.0
"""Pilots by name, as the commands take them: scripted, random, a policy that ships, a file."""
from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from dataclasses import field
from pathlib import Path

from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.pilots.random import RandomPilot
from ppo_agent_node.pilots.scripted import ROCKET_PILOTS
from ppo_agent_node.pilots.scripted import scripted_pilot
from ppo_agent_node.pilots.search import find_policy
from rocket_sim_node.worlds import WorldSpec

POLICY, EXPERT, RANDOM = 'policy', 'expert', 'random'
ESTIMATOR = 'expert_estimator'
NAMES = (POLICY, EXPERT, ESTIMATOR, RANDOM)
"""Names that are no policy's."""


@dataclass(frozen=True)
class Chosen:
    """A pilot with its name in tables."""

    label: str
    """what tables call it"""
    pilot: Pilot
    facts: dict[str, str] = field(default_factory=dict)
    """of a policy and of tuned gains: `policy_file` and `policy_sha256`"""
    warning: str = ''
    """in what the world differs from the one that a policy was trained in"""


def choose(name: str, spec: WorldSpec, seed: int = 0, policy: str = '') -> Chosen:
    """Return a pilot.

    :param name: `policy`, `expert`, `expert_estimator`, `random`, the name of a policy that ships,
        or a file: a policy's, or a `.json` of tuned gains, as `./bench tune` writes them.
    :param seed: of what the random pilot draws.
    :param policy: which one `policy` is, see `find_policy`.
    :raises FileNotFoundError: when there is no such policy.
    :raises ValueError: when the pilot does not fit the world.
    """
    if name == EXPERT:
        return Chosen(name, scripted_pilot(spec))
    if name == ESTIMATOR:
        return Chosen(name, ROCKET_PILOTS[name](spec))
    if name.endswith('.json'):
        return Chosen(
            Path(name).stem, tuned_pilot(Path(name), spec), _facts(Path(name)))
    if name == RANDOM:
        return Chosen(name, RandomPilot(spec, seed))
    given = policy if name == POLICY else name
    path = find_policy(given, spec.name)
    pilot = PolicyPilot(path, spec)
    return Chosen(_label(given) if given else name, pilot, _facts(path), pilot.unfamiliar)


def tuned_pilot(path: Path, spec: WorldSpec) -> Pilot:
    """Return the pilot of rockets whose gains a file holds.

    :raises FileNotFoundError: when there is no such file.
    :raises ValueError: when it holds none, or the pilot does not fit the world.
    """
    try:
        told = json.loads(path.read_text('utf-8'))
        pilot, gains = ROCKET_PILOTS[told['pilot']], dict(told['gains'])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f'{path}: got {error!r:.100}, expected tuned gains: pilot and gains') from error
    return pilot(spec, **gains)


def choose_all(names: Iterable[str], spec: WorldSpec, seed: int = 0, policy: str = '',
               ) -> list[Chosen]:
    """Return pilots whose labels differ: what would be there twice gets a number.

    :raises FileNotFoundError: and ValueError, as `choose` does.
    """
    found: list[Chosen] = []
    for one in (choose(name, spec, seed, policy) for name in names):
        label, number = one.label, 1
        while label in {other.label for other in found}:
            number += 1
            label = f'{one.label} {number}'
        found.append(Chosen(label, one.pilot, one.facts, one.warning))
    return found


def _facts(path: Path) -> dict[str, str]:
    """Return what tells later whether the file of a pilot is still the one that flew."""
    return {
        'policy_file': str(path), 'policy_sha256': hashlib.sha256(path.read_bytes()).hexdigest()}


def _label(given: str) -> str:
    """Return a short name for a policy: of the run that it lies in, or of its file."""
    path = Path(given)
    return path.parent.name or path.stem if path.name == 'policy.safetensors' else path.stem
