# SPDX-License-Identifier: Apache-2.0
"""Which policy to fly when nobody says: that of the newest whole run, else the one that ships."""
from __future__ import annotations

from importlib import resources
from pathlib import Path

from ppo_agent_node.learning import sealed_file
from ppo_agent_node.learning.policy_file import POLICY
from ppo_agent_node.learning.run_config import read_config
from ppo_agent_node.learning.run_folder import UNFINISHED

RUNS = Path('runs')


def find_policy(given: str, world: str, runs: Path = RUNS) -> Path:
    """Return the policy file to fly.

    :param given: a path; empty to search.
    :param world: name of the world that it was trained in.
    :param runs: folder of the runs, searched for the newest policy. One of a run that has not
        finished, and one that is damaged, are passed over.
    :raises FileNotFoundError: naming what was looked for.
    """
    if given:
        if not Path(given).is_file():
            raise FileNotFoundError(f'policy: no file {given}')
        return Path(given)
    trained = [
        path for path in runs.glob('*/policy.safetensors')
        if world_of(path.parent / 'config.yaml') == world
    ]
    for path in sorted(trained, key=lambda path: path.stat().st_mtime, reverse=True):
        if whole(path):
            return path
    shipped = Path(str(resources.files('ppo_agent_node') / 'policies' / f'{world}.safetensors'))
    if not shipped.is_file():
        raise FileNotFoundError(
            f'policy: none of a finished run below {runs.resolve()} for world {world!r}, and none '
            'ships for it; train one, or name a file')
    return shipped


def whole(policy: Path) -> bool:
    """Return whether the run of a policy has finished and its file can be read."""
    if (policy.parent / UNFINISHED).exists():
        return False
    try:
        sealed_file.read(policy, POLICY)
    except (ValueError, OSError):
        return False
    return True


def world_of(config: Path) -> str:
    """Return the world of a run, empty when its settings cannot be read."""
    try:
        return str(read_config(config).get('world') or '')
    except (OSError, ValueError):
        return ''
