# SPDX-License-Identifier: Apache-2.0
"""Conditions over DDS: equal draws and telemetry, and bad values are refused by name."""
from __future__ import annotations

import signal
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rocket_msgs import msg
from support.processes import Processes
from support.training.rollouts import assert_same

from rocket_sim_node import frames
from rocket_sim_node import worlds
from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.worlds import EnvironmentRestarted
from rocket_sim_node.worlds.rocket.conditions import DRAWN_NAMES

N = 8
MakeClient = Callable[..., Client]


def commands(steps: int, seed: int = 0) -> np.ndarray:
    """Random actions `(steps, N, 3)`, each for ten steps; every third one cuts the engine."""
    rng = np.random.default_rng(seed)
    chosen = rng.uniform(-1, 1, (-(-steps // 10), N, 3)).astype(np.float32)
    chosen[::3, :, 0] = -1.0
    return np.repeat(chosen, 10, axis=0)[:steps]


@pytest.mark.parametrize(('world', 'settings'), [
    ('rocket', {'conditions': 'mix', 'observation': 'extended'}),
    ('rocket_planar', {'conditions': 'mix', 'engine_lag_high': 0.05}),
])
def test_a_mix_flies_the_same_in_process_over_dds_and_after_a_kill(
    world: str, settings: dict[str, Any], processes: Processes, make_client: MakeClient,
) -> None:
    """A restarted simulator draws the same conditions again."""
    start = {'world': world, 'num_envs': N, **settings}
    simulator = processes.fork_node('rocket_sim_node', 'simulator', **start)
    client = make_client(patience=30.0)
    local = worlds.make(world, num_envs=N, seed=3, **settings)
    client.connect()
    assert client.spec == local.spec
    assert client.spec.condition_names == DRAWN_NAMES
    np.testing.assert_array_equal(client.reset(11, level=5), local.reset(11, level=5))
    episodes, steps = [], commands(900)
    for action in steps[:600]:
        ours = client.step(action)
        assert_same(ours, local.step(action))
        episodes.append(ours[4]['episodes'])
    flown = worlds.Episodes.concatenate(episodes)
    assert len(flown) > 10
    for name in ('fuel_left', 'ignitions', 'control_effort'):
        assert getattr(flown, name).any(), name
    state = client.snapshot()
    assert state == local.snapshot()
    simulator.signal(signal.SIGKILL)
    simulator.wait(5.0)
    processes.fork_node('rocket_sim_node', 'simulator', **start)
    with pytest.raises(EnvironmentRestarted):
        client.step(steps[600])
    client.restore(state)
    for action in steps[600:]:
        assert_same(client.step(action), local.step(action))


def test_conditions_of_a_reset_hold_until_the_next_reset(
        processes: Processes, make_client: MakeClient) -> None:
    processes.fork_node('rocket_sim_node', 'simulator', num_envs=N)
    client, local = make_client(), worlds.make('rocket', num_envs=N)
    for number, chosen in enumerate((
        {'conditions': 'hoverslam', 'level': 3},
        {'conditions': 'harsh', 'gust_deviation': (0.1, 0.2), 'engine_lag_low': 0.1},
        {}, {'action_delay': 2},
    )):
        np.testing.assert_array_equal(client.reset(7, **chosen), local.reset(7, **chosen))
        for action in commands(150, number):
            assert_same(client.step(action), local.step(action))
        assert client.snapshot() == local.snapshot()
    assert client.spec == local.spec, 'a reset changes nothing for good'


def test_state_holds_command_disturbance_and_drawn_conditions(
        processes: Processes, make_client: MakeClient) -> None:
    processes.fork_node(
        'rocket_sim_node', 'simulator', num_envs=N, conditions='harsh', state_rows=N)
    client = make_client()
    states: list[msg.RocketState] = []
    described: list[msg.World] = []
    client.node.create_subscription(msg.RocketState, 'state', states.append, qos.EVENTS)
    client.node.create_subscription(msg.World, 'world', described.append, qos.WORLD)
    client.connect()
    client.waiter.until(lambda: client.node.count_publishers('state') > 0, 10.0)
    local = worlds.make('rocket', num_envs=N, conditions='harsh')
    client.reset(2)
    local.reset(2)
    expected = [local.telemetry(slice(None))]
    for action in commands(100):
        client.step(action)
        local.step(action)
        expected.append(local.telemetry(slice(None)))
    client.close()
    session = described[-1].session
    client.waiter.until(lambda: any(max(s.step) >= 100 for s in states), 20.0)
    mine = [state for state in states if state.session == session]
    assert described[-1].condition_names == list(DRAWN_NAMES)

    def joined(name: str, width: int = 1) -> np.ndarray:
        values = np.concatenate([np.reshape(getattr(s, name), (-1, width)) for s in mine])
        return values[flying]

    # A last state shares its step with the first one of the next episode.
    flying = np.concatenate([s.outcome for s in mine]) == msg.RocketState.NONE
    step, row = (joined(name)[:, 0].astype(int) for name in ('step', 'row'))
    assert step.max() == 100
    for name, width in (('commanded_throttle', 1), ('disturbance', 3), ('conditions', 16)):
        kept = np.array([np.reshape(getattr(t, name), (N, -1)) for t in expected])[step, row]
        if name == 'disturbance':
            kept = frames.vector_to_ros(kept)
            assert not kept[:, 2].any(), 'nothing blows upwards'
        assert kept.any()
        np.testing.assert_array_equal(joined(name, width), kept)


@pytest.mark.parametrize(('given', 'complaint'), [
    ({'conditions': 'storm'},
     "parameter conditions: got 'storm', expected one of nominal, mix, harsh, hoverslam"),
    ({'observation': 'wide'},
     "parameter observation: got 'wide', expected one of standard, extended"),
    ({'engine_lag_high': -0.1}, 'parameter engine_lag_high: got -0.1, expected 0 to 10 s'),
    ({'conditions': 'mix', 'engine_lag_low': 0.5},
     "setting 'engine_lag_low': got 0.5, expected at most 'engine_lag_high', 0.2"),
    ({'world': 'lunar_lander', 'conditions': 'mix'},
     "parameter conditions: got 'mix', expected nominal, as world 'lunar_lander' has no others"),
    ({'world': 'lunar_lander', 'observation': 'extended'},
     "parameter observation: got 'extended', expected one of standard"),
])
def test_a_simulator_refuses_conditions_by_name(
        given: dict[str, Any], complaint: str, processes: Processes) -> None:
    simulator = processes.fork_node('rocket_sim_node', 'simulator', **given)
    assert simulator.wait(30.0) == 2
    said = [line for line in simulator.output().splitlines() if line]
    assert len(said) == 1, said
    assert said[0].endswith(complaint)


def test_a_reset_with_wrong_conditions_is_refused_and_changes_nothing(
        processes: Processes, make_client: MakeClient) -> None:
    for place, world in enumerate(('rocket', 'lunar_lander')):
        processes.fork_node(
            'rocket_sim_node', 'simulator', (f'__ns:=/sim_{place}',), world=world, num_envs=N,
            conditions='nominal', observation='standard')
    rocket, lander = (make_client(namespace=f'/sim_{place}') for place in range(2))
    rocket.reset(1)
    session = rocket.session
    for chosen, complaint in (
        ({'conditions': 'storm'}, "conditions: got 'storm', expected one of nominal, mix"),
        ({'engine_lag': (0.1, 0.2, 0.3)}, r'engine_lag: got \(0.1, 0.2, 0.3\), expected a number'),
        ({'engine_lag': 20.0}, 'engine_lag_low: got 20.0, expected 0 to 10 s'),
        ({'wind': 1.0}, "unknown setting 'wind'"),
    ):
        with pytest.raises(ValueError, match=complaint):
            rocket.reset(1, **chosen)
    rocket.step(commands(1)[0])
    assert rocket.session == session
    lander.reset(1)
    with pytest.raises(ValueError, match=(
            "conditions: got 'mix', expected none, as world 'lunar_lander' has no conditions")):
        lander.reset(1, conditions='mix')
