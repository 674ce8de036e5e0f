# SPDX-License-Identifier: Apache-2.0
"""Digests of all results of each world and of a short training with each preset.

Run it on two commits to find out whether a change of the code has altered any bit of the results.
It uses only the commands, the files of a run and `worlds.make`, so it does not depend on how the
modules are arranged.
"""
from __future__ import annotations

import argparse
import hashlib
import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load_file

from benchmarks import machine
from rocket_sim_node import worlds

ROOT = Path(__file__).parents[2]
STEPS = 600
FLOWN: list[tuple[str, dict[str, Any]]] = [
    ('rocket', {}),
    ('rocket', {'conditions': 'mix', 'observation': 'extended'}),
    ('rocket', {'conditions': 'harsh', 'level': 8}),
    ('rocket', {'conditions': 'hoverslam'}),
    ('rocket_planar', {}),
    ('rocket_planar', {'conditions': 'harsh'}),
    ('lunar_lander', {}),
    ('lunar_lander', {'continuous': True}),
]
_SHORT = ['num_envs:=64', 'iterations:=3', 'selection_episodes:=64', 'record:=false']
_IMITATION = [
    'demonstration_episodes:=64', 'dagger_rounds:=1', 'clone_epochs:=2', 'dagger_epochs:=1']
TRAINED: dict[str, list[str]] = {
    'rocket default': [*_SHORT, *_IMITATION, 'evaluation_episodes:=128'],
    'rocket robust': [*_SHORT, *_IMITATION, 'evaluation_episodes:=64'],
    'rocket hoverslam': [*_SHORT, *_IMITATION, 'evaluation_episodes:=64'],
    'rocket from_scratch': [*_SHORT, 'evaluation_episodes:=64'],
    'rocket_planar default': [*_SHORT, *_IMITATION, 'evaluation_episodes:=128'],
    'lunar_lander default': [*_SHORT, 'evaluation_episodes:=64'],
}


def digest(parts: Iterable[bytes]) -> str:
    """Return the first 16 hexadecimal digits of the SHA-256 of some bytes."""
    found = hashlib.sha256()
    for part in parts:
        found.update(part)
    return found.hexdigest()[:16]


def flown(name: str, settings: dict[str, Any]) -> str:
    """Fly a world with random actions; return the digest of its outputs and of its snapshot."""
    world = worlds.make(name, num_envs=64, seed=7, **settings)
    random = np.random.default_rng(7)
    spec = world.spec
    seen = [world.reset(seed=7).tobytes()]
    for _ in range(STEPS):
        action: Any = (
            random.uniform(-1, 1, (spec.num_envs, spec.action_size)).astype(np.float32)
            if spec.continuous else random.integers(spec.action_count, size=spec.num_envs))
        seen += [np.ascontiguousarray(part).tobytes() for part in world.step(action)[:4]]
    return digest([*seen, world.snapshot()])


def trained(world: str, preset: str, arguments: list[str], run: Path) -> dict[str, str]:
    """Train through simulator and agent; return the digests of the files that hold results.

    :raises CalledProcessError: if the training failed.
    """
    subprocess.run(
        [ROOT / 'launch_scripts' / 'train', f'world:={world}', f'preset:={preset}', 'seed:=3',
         f'run_dir:={run}', *arguments], check=True, stdout=subprocess.DEVNULL)
    files = sorted([*run.glob('*.safetensors'), *run.glob('checkpoints/*.safetensors')])
    found = {
        str(path.relative_to(run)): digest(
            name.encode() + array.tobytes() for name, array in sorted(load_file(path).items()))
        for path in files}
    return {**found, 'episodes.csv': digest([(run / 'episodes.csv').read_bytes()])}


def main() -> None:
    """Print all digests, one per line."""
    parser = argparse.ArgumentParser(prog='bench digests', description=__doc__)
    parser.add_argument(
        '--only', default='',
        help='only digests whose names begin with this text, such as "lunar_lander"')
    parser.add_argument('--output', type=Path, help='ignored; the digests are only printed')
    options = parser.parse_args()
    print(f'commit {machine.commit()}')
    for name, settings in FLOWN:
        title = ' '.join([name, *(f'{key}={value}' for key, value in settings.items())])
        if title.startswith(options.only):
            print(f'{flown(name, settings)}  {title}, {STEPS} steps and snapshot', flush=True)
    for title, arguments in TRAINED.items():
        if not title.startswith(options.only):
            continue
        with tempfile.TemporaryDirectory() as folder:
            for file, found in trained(*title.split(), arguments, Path(folder) / 'run').items():
                print(f'{found}  {title}: {file}', flush=True)


if __name__ == '__main__':
    main()
