# SPDX-License-Identifier: Apache-2.0
"""Which policy to fly when nobody says: the newest trained here, else the one that ships."""
from __future__ import annotations

from importlib import resources
from pathlib import Path

from ppo_agent_node.learning.run_config import read_config

RUNS = Path('runs')


def find_policy(given: str, world: str, runs: Path = RUNS) -> Path:
    """Return the policy file to fly.

    :param given: a path; empty to search.
    :param world: name of the world that it was trained in.
    :param runs: folder of the runs, searched for the newest policy.
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
    if trained:
        return max(trained, key=lambda path: path.stat().st_mtime)
    shipped = Path(str(resources.files('ppo_agent_node') / 'policies' / f'{world}.safetensors'))
    if not shipped.is_file():
        raise FileNotFoundError(
            f'policy: none below {runs.resolve()} for world {world!r}, and none ships for it; '
            'train one, or name a file')
    return shipped


def world_of(config: Path) -> str:
    """Return the world of a run, empty when its settings cannot be read."""
    try:
        return str(read_config(config).get('world') or '')
    except (OSError, ValueError):
        return ''
