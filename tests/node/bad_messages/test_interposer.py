# SPDX-License-Identifier: Apache-2.0
"""Messages dropped, duplicated, delayed or reordered: no step is lost or taken twice."""
from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.network import interposer
from support.processes import Processes
from support.training.rollouts import assert_same
from support.training.training_runs import LOW
from support.training.training_runs import agent
from support.training.training_runs import assert_same_run
from support.training.training_runs import train_in_process

from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.client.connection import ConnectionOptions
from rocket_sim_node.wire.client.fleet import SimulatorFleet
from rocket_sim_node.worlds import make
from rocket_sim_node.worlds.jobs import Act
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import Results
from rocket_sim_node.worlds.jobs import SerialFleet
from rocket_sim_node.worlds.jobs import Snapshot

N = 8
SHARE = 0.04
"""of messages that suffer each of the four faults"""
BRIEF = {
    'demonstration_episodes': 8, 'iterations': 2, 'selection_interval': 2,
    'evaluation_episodes': 8}
"""One flight of each rocket in each stage: each message that is resent costs its time."""


def tell(counts: Counter[str]) -> None:
    """Print the number of faults, and assert that each kind occurred."""
    print(', '.join(f'{counts[name]} {name}' for name in ('messages', *interposer.FAULTS)))
    assert all(counts[name] > 0 for name in interposer.FAULTS), counts


def fly_through(client: Client, world: Any, seed: int, steps: int) -> None:
    """Fly both alike, and compare each answer and where they are in the end."""
    np.testing.assert_array_equal(client.reset(seed), world.reset(seed))
    actions = np.random.default_rng(seed).uniform(-1, 1, (steps, N, 3)).astype(np.float32)
    for number, action in enumerate(actions):
        try:
            assert_same(client.step(action), world.step(action))
        except AssertionError as error:
            raise AssertionError(f'seed {seed}, step {number}: {error}') from error
    assert client.connection.step == steps, f'seed {seed}'
    # With all counters and random streams: one step more or less would show.
    assert client.snapshot() == world.snapshot(), f'seed {seed}'


def test_each_step_is_taken_once(
        processes: Processes, make_client: Callable[..., Client], nightly: bool) -> None:
    rounds, steps = (50, 600) if nightly else (2, 250)
    processes.fork_node('rocket_sim_node', 'simulator', interposer.FAR, num_envs=N)
    client = make_client(resend_after=0.02)
    world = make('rocket', num_envs=N)
    counts: Counter[str] = Counter()
    for seed in range(1, rounds + 1):
        node, output = interposer.start(processes, seed, SHARE)
        fly_through(client, world, seed, steps)
        counts += interposer.stop(node, output)
    tell(counts)
    print(f'{rounds * steps} steps, {client.resent} actions sent again')
    assert client.resent > 0


def observed_first(seed: int, steps: int) -> Job[tuple[Any, ...]]:
    """Fly on each observation, before its results arrive; return all answers and the end."""
    found: list[Any] = [(yield Reset(seed))]
    results: list[Any] = []

    def record(each: Results) -> None:
        *arrays, info = each
        results.extend([*arrays, info['final_rows'], info['final_observation'], *(
            vars(info['episodes']).values() if len(info['final_rows']) else ())])

    for action in np.random.default_rng(seed).uniform(-1, 1, (steps, N, 3)).astype(np.float32):
        found.append((yield Act(action, record)))
    end = yield Snapshot()
    return np.concatenate(found + results, axis=None), end


def test_each_step_is_taken_once_if_the_next_action_is_ready_early(
        processes: Processes, make_node: Callable[..., Any]) -> None:
    processes.fork_node('rocket_sim_node', 'simulator', interposer.FAR, num_envs=N)
    fleet = SimulatorFleet(*make_node(), ConnectionOptions(0.02, 20.0), 1)
    node, output = interposer.start(processes, 7, SHARE)
    flights = [functools.partial(observed_first, seed, 250) for seed in (1, 2)]
    for ours, theirs in zip(
            fleet.fly(flights), SerialFleet(make('rocket', num_envs=N)).fly(flights), strict=True):
        np.testing.assert_array_equal(ours[0], theirs[0])
        assert ours[1] == theirs[1]
    tell(interposer.stop(node, output))
    fleet.close()


@pytest.fixture(scope='module')
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in one process, without ROS."""
    return train_in_process(tmp_path_factory.mktemp('undisturbed') / 'run', **BRIEF)


@pytest.mark.usefixtures('nightly_only')
def test_training_learns_the_same(
        processes: Processes, tmp_path: Path, undisturbed: Path) -> None:
    processes.fork_node('rocket_sim_node', 'simulator', interposer.FAR, num_envs=N, **LOW)
    counts: Counter[str] = Counter()
    for seed in range(1, 51):
        run = tmp_path / f'run_{seed}'
        node, output = interposer.start(processes, seed, SHARE / 4)
        trainer = agent(processes, run, resend_after=0.02, **BRIEF)
        assert trainer.wait(240.0) == 0, f'seed {seed}'
        counts += interposer.stop(node, output)
        assert_same_run(run, undisturbed)
    tell(counts)
