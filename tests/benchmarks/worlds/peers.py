# SPDX-License-Identifier: Apache-2.0
"""Steps per second and exactness of PyFlyt, Gymnasium, EnvPool and this project on one core.

Random actions, episodes and resets are included. All are measured alternately in several rounds,
so that disturbances affect all of them. Medians are reported. Exactness is tested: the
same seed and actions run twice in a process and once in another one, and a copy of the environment
continues from the middle of an episode. Peers that cannot be used are listed with the reason.
"""
from __future__ import annotations

import argparse
import contextlib
import copy
import hashlib
import os
import statistics
import subprocess
import sys
from collections.abc import Callable
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from benchmarks import machine
from benchmarks.reports import page
from benchmarks.worlds.stepping import rate
from ppo_agent_node.evaluation.conditions_files import aligned
from ppo_agent_node.evaluation.metrics import write_json
from rocket_sim_node import worlds

ROOT = Path(__file__).parents[3]
PAGE = ROOT / 'docs' / 'explanation' / 'peers.md'
CHECKED = 200
"""number of steps in a test of exactness"""
_SEED = 1


@dataclass(frozen=True)
class Peer:
    """A side of the comparison."""

    make: Callable[[int], tuple[Callable[[NDArray[Any]], Any], Any]]
    """returns step and environment for a number of environments, reset with seed 1"""
    actions: Callable[[int], NDArray[Any]]
    """returns 16 batches of actions for a number of environments"""
    sizes: tuple[int, ...]
    """one environment, and the batch sizes to try for the best speed"""
    step_seconds: float
    """simulated time of a step"""
    copies: str = 'deepcopy'
    """how a copy is made: deepcopy of the environment, or our snapshot"""


def _discrete(num_envs: int) -> NDArray[Any]:
    return np.random.default_rng(0).integers(0, 4, (16, num_envs))


def _continuous(low: Any, high: Any) -> Callable[[int], NDArray[Any]]:
    def draw(num_envs: int) -> NDArray[Any]:
        uniform = np.random.default_rng(0).random((16, num_envs, len(low)))
        return (np.asarray(low) + uniform * (np.asarray(high) - low)).astype(np.float32)
    return draw


def _ours(world: str, **settings: Any) -> Callable[[int], Any]:
    def make(num_envs: int) -> Any:
        made = worlds.make(world, num_envs=num_envs, seed=_SEED, **settings)
        return made.step, made
    return make


def _gymnasium(num_envs: int) -> Any:
    env = gymnasium.make_vec(
        'LunarLander-v3', num_envs=num_envs, vectorization_mode='sync',
        vector_kwargs={'autoreset_mode': AutoresetMode.SAME_STEP})
    env.reset(seed=_SEED)
    return env.step, env


def _envpool(num_envs: int) -> Any:
    import envpool

    env = envpool.make(
        'LunarLander-v3', env_type='gymnasium', num_envs=num_envs, batch_size=num_envs,
        num_threads=1, seed=_SEED)
    env.reset()
    return lambda action: env.step(action.astype(np.int32)), env


def _pyflyt(num_envs: int) -> Any:
    import PyFlyt.gym_envs  # noqa: F401

    env = gymnasium.vector.SyncVectorEnv(
        [lambda: gymnasium.make('PyFlyt/Rocket-Landing-v4', disable_env_checker=True)] * num_envs,
        autoreset_mode=AutoresetMode.SAME_STEP)
    env.reset(seed=_SEED)
    return env.step, env


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Suppress what Bullet prints from C."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


PEERS = {
    'PyFlyt Rocket-Landing': Peer(
        _pyflyt, _continuous([-1, -1, -1, 0, 0, -1, -1], [1] * 7), (1, 4), 1 / 40),
    'Gymnasium LunarLander': Peer(_gymnasium, _discrete, (1, 64), 1 / 50),
    'EnvPool LunarLander': Peer(_envpool, _discrete, (1, 16, 64), 1 / 50),
    'ours, lunar_lander': Peer(
        _ours('lunar_lander'), _discrete, (1, 256), 1 / 50, 'snapshot'),
    'ours, rocket': Peer(
        _ours('rocket', level=7), _continuous([-1] * 3, [1] * 3), (1, 4096), 1 / 50, 'snapshot'),
    'ours, rocket_planar': Peer(
        _ours('rocket_planar', level=7), _continuous([-1] * 3, [1] * 3), (1, 256), 1 / 50,
        'snapshot'),
}


def available(names: list[str]) -> dict[str, str]:
    """Return the peers that cannot be used, with the reason."""
    found = {}
    for name in names:
        try:
            _, env = PEERS[name].make(1)
        except (ImportError, OSError) as error:
            found[name] = f'{type(error).__name__}: {error}'
        else:
            _close(env)
    return found


def _close(env: Any) -> None:
    close = getattr(env, 'close', None)
    if close is not None:
        with _silence():
            close()


def _observed(step: Callable[[NDArray[Any]], Any], actions: NDArray[Any], count: int) -> bytes:
    return b''.join(
        np.ascontiguousarray(step(actions[index % len(actions)])[0]).tobytes()
        for index in range(count))


def digest(name: str) -> str:
    """Return a digest of the observations of the first steps of one environment."""
    peer = PEERS[name]
    with _silence():
        step, env = peer.make(1)
        seen = _observed(step, peer.actions(1), CHECKED)
    _close(env)
    return hashlib.sha256(seen).hexdigest()


def elsewhere(name: str) -> str:
    """Return the same digest, computed by another process."""
    done = subprocess.run(
        [sys.executable, '-m', 'benchmarks.worlds.peers', '--digest', name], check=True,
        stdout=subprocess.PIPE, text=True, env=machine.child_environment())
    return done.stdout.split()[-1]


def copied(name: str) -> str:
    """Return whether a copy continues with the same bits, or the error that it raises."""
    peer = PEERS[name]
    actions = peer.actions(1)
    with _silence():
        step, env = peer.make(1)
        _observed(step, actions, 40)
        try:
            kept = env.snapshot() if peer.copies == 'snapshot' else copy.deepcopy(env)
            first = _observed(step, actions, 40)
            if peer.copies == 'snapshot':
                env.restore(kept)
            second = _observed(
                step if peer.copies == 'snapshot' else kept.step, actions, 40)
        except Exception as error:  # noqa: BLE001  any error is an answer here
            return f'no: {type(error).__name__}'
    _close(env)
    return 'same bits' if first == second else 'other bits'


def measure(names: list[str], rounds: int, seconds: float) -> dict[str, dict[int, float]]:
    """Return the median of steps/s by peer and number of environments."""
    made = {}
    with _silence():
        for name in names:
            peer = PEERS[name]
            for size in peer.sizes:
                made[name, size] = peer.make(size)[0], peer.actions(size)
    samples: dict[tuple[str, int], list[float]] = {key: [] for key in made}
    with _silence():
        for step, actions in made.values():
            rate(step, actions, 0.2 * seconds)
        for _ in range(rounds):
            for key, (step, actions) in made.items():
                samples[key].append(rate(step, actions, seconds))
    found: dict[str, dict[int, float]] = {name: {} for name in names}
    for (name, size), rates in samples.items():
        found[name][size] = statistics.median(rates)
    return found


def main() -> None:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(prog='bench peers', description=__doc__.split('\n')[0])
    parser.add_argument('--rounds', type=int, default=5, help='number of rounds')
    parser.add_argument(
        '--seconds', type=float, default=1.0, help='duration of one measurement, s')
    parser.add_argument('--only', nargs='+', choices=list(PEERS), default=list(PEERS),
                        metavar='PEER', help='peers; by default all')
    parser.add_argument(
        '--page', action='store_true', help='put the results into docs/explanation/peers.md')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    parser.add_argument('--digest', help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.digest:
        print(digest(options.digest))
        return
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    with _silence():
        missing = available(options.only)
    names = [name for name in options.only if name not in missing]
    table = measure(names, options.rounds, options.seconds)
    rows: list[tuple[str, ...]] = [(
        '', 'steps/s, one', 'steps/s, best', 'at', 'simulated s per s, best',
        'same seed, same process', 'other process', 'copy in mid-episode')]
    figures: dict[str, Any] = {'steps_per_second': table, 'missing': missing, 'exact': {}}
    for name in names:
        best = max(table[name], key=lambda size: table[name][size])
        reference = digest(name)
        exact = {
            'same process': 'same bits' if digest(name) == reference else 'other bits',
            'other process': 'same bits' if elsewhere(name) == reference else 'other bits',
            'copy': copied(name)}
        figures['exact'][name] = exact
        rows.append((
            name, f'{table[name][1]:,.0f}', f'{table[name][best]:,.0f}', f'{best:,}',
            f'{table[name][best] * PEERS[name].step_seconds:,.0f}', *exact.values()))
    text = aligned(rows)
    print(text)
    for name, reason in missing.items():
        print(f'{name}: not measured: {reason}')
    described = machine.describe()
    command = (f'./launch_scripts/bench peers --rounds {options.rounds} '
               f'--seconds {options.seconds:g}')
    if options.output:
        write_json(options.output, {**figures, 'command': command, 'machine': described})
    if options.page:
        versions = ', '.join(f'{each} {machine.version(each)}' for each in (
            'PyFlyt', 'pybullet', 'gymnasium', 'box2d', 'envpool', 'pymunk', 'numpy'))
        absent = ''.join(f'\n\n{name} was not measured: {reason}.'
                         for name, reason in missing.items())
        page.put(PAGE, 'peers', (
            f'`{command}`: {described["date"]}, commit {described["commit"]}; one core of '
            f'{described["processor"]}; {versions}.\n\n{text}{absent}'))


if __name__ == '__main__':
    main()
