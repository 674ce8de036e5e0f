# SPDX-License-Identifier: Apache-2.0
"""Search for the default policy: the newest finished run's, else the built-in one."""
from __future__ import annotations

from importlib import resources
from pathlib import Path

from ppo_agent_node.runs.config_file import read_config

RUNS = Path('runs')
DEFAULT = 'default'
"""Name of a world's built-in policy, the same for each world."""


def find_policy(given: str, world: str, runs: Path = RUNS) -> Path:
    """Return the policy file to fly.

    :param given: a path, or the name of a built-in policy; empty to search. `default` is the
        built-in policy of the world.
    :param world: name of the world that it was trained in.
    :param runs: folder of the runs, searched for the newest policy. Unfinished runs and damaged
        files are skipped.
    :raises FileNotFoundError: naming what was searched for.
    """
    if given:
        return _named(given, world)
    trained = [
        path for path in runs.glob('*/policy.safetensors')
        if world_of(path.parent / 'config.yaml') == world
    ]
    for path in sorted(trained, key=lambda path: path.stat().st_mtime, reverse=True):
        if whole(path):
            return path
    shipped = _shipped(world)
    if not shipped.is_file():
        raise FileNotFoundError(
            f'policy: no finished run of world {world!r} below {runs.resolve()}, and no policy '
            'ships for it; train one, or name a file')
    return shipped


def shipped_names() -> tuple[str, ...]:
    """Return the names of the built-in policies."""
    folder = Path(str(resources.files('ppo_agent_node') / 'policies'))
    return tuple(sorted(path.stem for path in folder.glob('*.safetensors')))


def _named(given: str, world: str) -> Path:
    """Return the policy for a path or a name; a file takes precedence over a name.

    :raises FileNotFoundError: naming the argument and the available policies.
    """
    if Path(given).is_file():
        return Path(given)
    if Path(given).name != given or '.' in given:
        raise FileNotFoundError(f'policy: no file {given}')
    shipped = _shipped(world if given == DEFAULT else given)
    if not shipped.is_file():
        raise FileNotFoundError(
            f'policy: got {given!r}, expected a file or the name of a policy that ships: '
            f'{", ".join((DEFAULT, *shipped_names()))}')
    return shipped


def _shipped(name: str) -> Path:
    return Path(str(resources.files('ppo_agent_node') / 'policies' / f'{name}.safetensors'))


def whole(policy: Path) -> bool:
    """Return whether the run of a policy has finished and its file can be read.

    :raises ValueError: where PyTorch, which reads it, is missing.
    """
    require_torch(policy)
    from ppo_agent_node.ppo.policies.file import POLICY
    from ppo_agent_node.runs import tensor_file
    from ppo_agent_node.runs.run_lock import UNFINISHED

    if (policy.parent / UNFINISHED).exists():
        return False
    try:
        tensor_file.read(policy, POLICY)
    except (ValueError, OSError):
        return False
    return True


def require_torch(policy: Path) -> None:
    """Check that policy files can be read here.

    :raises ValueError: where there is no PyTorch; the message says what can be flown without.
    """
    try:
        import torch  # noqa: F401  (checks that it is installed)
    except ImportError as error:
        raise ValueError(
            f'{policy}: needs PyTorch, which cannot be imported here ({error}); an ONNX file from '
            './launch_scripts/export needs none') from error


def world_of(config: Path) -> str:
    """Return the world of a run, empty when its settings cannot be read."""
    try:
        return str(read_config(config).get('world') or '')
    except (OSError, ValueError):
        return ''
