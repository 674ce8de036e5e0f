# SPDX-License-Identifier: Apache-2.0
"""Where a policy comes from: preset, conditions and commit of its training."""
from __future__ import annotations

import hashlib
from importlib import resources
from pathlib import Path
from typing import Any

from ppo_agent_node.runs.config_file import read_config
from rocket_sim_node import plain_yaml

SHIPPED = Path(str(resources.files('ppo_agent_node') / 'policies'))
FILE = SHIPPED / 'provenance.yaml'
KEYS = ('preset', 'conditions', 'commit')


def of(path: Path, content: dict[str, Any]) -> dict[str, Any]:
    """Return what is known of a policy's training, beside what its file says.

    :param path: the policy file; the settings of its run are read where they lie beside it.
    """
    identity = {
        'policy_file': path.name,
        'policy_sha256': hashlib.sha256(path.read_bytes()).hexdigest()}
    if path.parent.resolve() == SHIPPED.resolve():
        return {**identity, **shipped().get(path.stem, {})}
    training = content.get('training', {})
    found = {name: training[name] for name in KEYS if name in training}
    run = read_config(path.with_name('config.yaml')) if path.name == 'policy.safetensors' else {}
    if 'conditions' not in found and 'training' in run:
        found['conditions'] = run['training'].get('conditions') or run.get('conditions', '')
    if 'version' in run:
        found['version'] = run['version']
    return {**identity, **found}


def shipped() -> dict[str, dict[str, Any]]:
    """Return where the policies that ship come from, by name."""
    found: dict[str, dict[str, Any]] = plain_yaml.load(FILE.read_text('utf-8'))
    return found
