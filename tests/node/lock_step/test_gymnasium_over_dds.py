# SPDX-License-Identifier: Apache-2.0
"""Gymnasium's environments over DDS are those in process, bit for bit."""
from __future__ import annotations

import hashlib
import signal
from contextlib import nullcontext
from copy import deepcopy
from typing import Any

import gymnasium
import numpy as np
import pytest
from support.processes import Processes

import rocket_sim_node.gym
from rocket_sim_node.gym import ReverseCurriculum
from rocket_sim_node.gym import over_dds as over_dds_module

NAME = rocket_sim_node.gym.IDS['rocket']
N, STEPS = 4, 200
LOW = {'spawn_reach': 15.0}


@pytest.fixture
def over_dds(processes: Processes, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Environments of two simulators, and a function that makes more."""
    monkeypatch.setenv('ROS_DOMAIN_ID', str(processes.domain))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    # Fast DDS reads its profile once per process, and nodes of other tests came first.
    monkeypatch.setattr(over_dds_module, 'prepared', nullcontext)
    nodes = [processes.fork_node(
        'rocket_sim_node', 'simulator', remap=(f'__ns:=/sim_{number}',), num_envs=N)
        for number in range(2)]
    made = []

    def make(num_envs: int = N, simulators: str = '/sim_0', **keywords: Any) -> Any:
        made.append(gymnasium.make_vec(
            NAME, num_envs=num_envs, simulators=simulators, **{'patience': 20.0, **keywords}))
        return made[-1]

    make.nodes = nodes
    yield make
    for envs in made:
        envs.close()


def in_process(**keywords: Any) -> Any:
    return gymnasium.make_vec(NAME, num_envs=N, **LOW, **keywords)


def weights(envs: Any, steps: int) -> str:
    """Return the hash of the weights after a training of stable-baselines3."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    from rocket_sim_node.gym.sb3 import HoverslamVecEnv

    model = PPO('MlpPolicy', VecNormalize(HoverslamVecEnv(envs)), n_steps=128, batch_size=128,
                n_epochs=2, seed=3, device='cpu').learn(steps)
    found = hashlib.sha256()
    for tensor in model.policy.state_dict().values():
        found.update(tensor.numpy().tobytes())
    return found.hexdigest()


def test_flights_over_dds_are_those_in_process(over_dds: Any) -> None:
    ours = over_dds(**LOW)
    theirs = in_process()
    assert ours.observation_space == theirs.observation_space
    ended = _compare([ours], [theirs], [7])
    assert ended

    copy = gymnasium.make_vec(NAME, num_envs=N)  # as the simulators were started
    copy.restore(ours.snapshot())
    with pytest.raises(TypeError, match=r'^deepcopy: an environment of rocket cannot be copied'):
        deepcopy(ours)
    action = ours.action_space.sample()
    np.testing.assert_array_equal(ours.step(action)[0], copy.step(action)[0])

    # Two simulators as one batch: the second is reset with the next seed.
    ours.close()
    both = over_dds(2 * N, '/sim_*', **LOW)
    assert _compare([both], [in_process(), in_process()], [7, 8])
    state = both.snapshot()
    action = both.action_space.sample()
    expected = both.step(action)[0]
    both.restore(state)
    np.testing.assert_array_equal(both.step(action)[0], expected)
    with pytest.raises(ValueError, match='snapshot: not readable, 5 bytes'):
        both.restore(b'wrong')
    with pytest.raises(ValueError, match=r'seed: got 9223372036854775807, .* to 2\*\*63 - 2'):
        both.reset(seed=2**63 - 1)

    with pytest.raises(ValueError, match=r'max_thrust: got 5\.0, expected 470880, the value'):
        over_dds(simulators='/sim_0', max_thrust=5.0)
    with pytest.raises(ValueError, match='num_envs: got 3, expected a multiple of 4'):
        over_dds(3)


def test_a_step_without_an_answer_can_only_be_repeated(over_dds: Any) -> None:
    """One simulator may have taken it, and would answer another action with its result."""
    ours = over_dds(2 * N, '/sim_*', patience=2.0)
    first, _ = ours.reset(seed=1)
    action, other = np.zeros((2 * N, 3), np.float32), np.ones((2 * N, 3), np.float32)
    over_dds.nodes[1].signal(signal.SIGSTOP)
    try:
        with pytest.raises(TimeoutError):
            ours.step(action)
    finally:
        over_dds.nodes[1].signal(signal.SIGCONT)
    with pytest.raises(ValueError, match='action: got another one than that of the last step'):
        ours.step(other)
    assert not np.array_equal(ours.step(action)[0], first)
    ours.step(other)
    ours.reset(seed=1)
    ours.step(other)


def test_bad_options_over_dds_name_the_field(over_dds: Any) -> None:
    with pytest.raises(TypeError, match="level: got 'a', expected a number"):
        over_dds(level='a')
    envs = over_dds()
    for value, message in (
            ('a', "got 'a', expected a number"), (None, 'got None, expected a number'),
            (True, 'got True, expected a number'), (99, 'got 99, expected')):
        with pytest.raises((TypeError, ValueError), match=f'level: {message}'):
            envs.reset(options={'level': value})
    envs.reset(seed=3)


def test_the_reverse_curriculum_over_dds_is_that_in_process(over_dds: Any) -> None:
    idle = np.tile(np.float32([-1, 0, 0]), (N, 1))  # from so low, falling is landing
    ours, theirs = (
        ReverseCurriculum(envs, window=N, landing_rate=0.9)
        for envs in (over_dds(), gymnasium.make_vec(NAME, num_envs=N)))
    np.testing.assert_array_equal(ours.reset(seed=5)[0], theirs.reset(seed=5)[0])
    for _ in range(60):
        for one, other in zip(ours.step(idle)[:4], theirs.step(idle)[:4], strict=True):
            np.testing.assert_array_equal(one, other)
        assert ours.reach == theirs.reach
    assert ours.reach > 0.4


def _compare(ours: list[Any], theirs: list[Any], seeds: list[int]) -> int:
    """Fly both and compare; return how many episodes ended."""
    envs, = ours
    first = [one.reset(seed=seed)[0] for one, seed in zip(theirs, seeds, strict=True)]
    np.testing.assert_array_equal(envs.reset(seed=seeds[0])[0], np.concatenate(first))
    envs.action_space.seed(3)
    ended = 0
    for _ in range(STEPS):
        action = envs.action_space.sample()
        *got, info = envs.step(action)
        answers = [one.step(part) for one, part in zip(
            theirs, np.split(action, len(theirs)), strict=True)]
        for index, values in enumerate(got):
            expected = np.concatenate([answer[index] for answer in answers])
            np.testing.assert_array_equal(values, expected)
            assert values.flags.writeable
        for k, answer in enumerate(answers):
            for name, values in answer[4].get('final_info', {}).items():
                seen = info['final_info'][name][k * N:(k + 1) * N]
                np.testing.assert_array_equal(seen, values)
                ended += name == '_outcome' and int(values.sum())
    return ended


def test_weights_of_stable_baselines3_are_those_in_process(over_dds: Any, nightly: bool) -> None:
    pytest.importorskip('stable_baselines3')
    steps = 40_960 if nightly else 1_024
    local = weights(in_process(seed=5), steps)
    assert weights(over_dds(seed=5, **LOW), steps) == local
    print(f'weights after {steps} steps, in process and over DDS: sha256 {local}')
