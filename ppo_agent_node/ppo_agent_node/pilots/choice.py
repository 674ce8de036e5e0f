# SPDX-License-Identifier: Apache-2.0
"""Selection of pilots by name in commands: scripted, random, a built-in policy, or a file."""
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
from rocket_sim_node import input_file
from rocket_sim_node.worlds import WorldSpec

POLICY, EXPERT, RANDOM = 'policy', 'expert', 'random'
ESTIMATOR = 'expert_estimator'
NAMES = (POLICY, EXPERT, ESTIMATOR, RANDOM)
"""Reserved names, which are not names of policies."""
LARGEST_GAINS = 1_000_000
"""Maximum bytes of a file of tuned gains."""


@dataclass(frozen=True)
class Chosen:
    """A pilot and its label in tables."""

    label: str
    """Its label in tables."""
    pilot: Pilot
    facts: dict[str, str] = field(default_factory=dict)
    """For policies and tuned gains: `policy_file` and `policy_sha256`."""
    warning: str = ''
    """How the world differs from the one that a policy was trained in."""


def choose(name: str, spec: WorldSpec, seed: int = 0, policy: str = '') -> Chosen:
    """Return a pilot.

    :param name: `policy`, `expert`, `expert_estimator`, `random`, the name of a built-in policy,
        or a file: a policy, or a `.json` of tuned gains from `bench tune`.
    :param seed: of the random pilot.
    :param policy: the policy to fly if `name` is `policy`; see `find_policy`.
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
    """Return the rocket pilot with the gains in a file.

    :raises FileNotFoundError: when there is no such file.
    :raises ValueError: when it has no gains, or the pilot does not fit the world.
    """
    text = input_file.read_text(path, LARGEST_GAINS)
    try:
        content = json.loads(text)
        pilot, gains = ROCKET_PILOTS[content['pilot']], dict(content['gains'])
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise ValueError(
            f'{path}: got {error!r:.100}, expected tuned gains: pilot and gains') from error
    try:
        return pilot(spec, **gains)
    except (TypeError, ValueError) as error:
        raise ValueError(f'{path}: {error}') from error


def choose_all(names: Iterable[str], spec: WorldSpec, seed: int = 0, policy: str = '',
               ) -> list[Chosen]:
    """Return pilots with different labels: repeated ones get a number.

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
    """Return the path and hash that identify the file of a pilot later."""
    return {
        'policy_file': str(path), 'policy_sha256': hashlib.sha256(path.read_bytes()).hexdigest()}


def _label(given: str) -> str:
    """Return a short name for a policy: of its run's folder, or of its file."""
    path = Path(given)
    return path.parent.name or path.stem if path.name == 'policy.safetensors' else path.stem
