# SPDX-License-Identifier: Apache-2.0
"""The wire when simulators start, stop, die, fall silent or have another name."""
from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from rocket_msgs import msg
from rocket_msgs import srv
from support.nodes.speaker import Speaker
from support.processes import Process
from support.processes import Processes
from support.training.rollouts import assert_same
from support.training.rollouts import random_actions

from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.client.connection import ConnectionOptions
from rocket_sim_node.wire.client.connection import SimulatorBusy
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.wire.messages.definitions import DefinitionsDiffer
from rocket_sim_node.wire.node.waiting import WireTimeout
from rocket_sim_node.worlds import EnvironmentRestarted
from rocket_sim_node.worlds import make

N = 8
MakeClient = Callable[..., Client]
actions = partial(random_actions, N)


@pytest.fixture
def simulator(processes: Processes) -> Process:
    """A simulator of N rockets, level 7."""
    return processes.fork_node('rocket_sim_node', 'simulator', num_envs=N)


def test_the_largest_batch_is_flown_and_restored(
        processes: Processes, make_client: MakeClient) -> None:
    processes.fork_node('rocket_sim_node', 'simulator', num_envs=conversion.MOST_ENVS)
    client = make_client(resend_after=5.0)  # as a slow machine is no lost message
    world = make('rocket', num_envs=conversion.MOST_ENVS)
    client.reset(1)
    world.reset(1)
    action = np.full((conversion.MOST_ENVS, 3), 0.5, np.float32)
    for _ in range(10):
        assert_same(client.step(action), world.step(action))
        state = client.snapshot()
        assert state == world.snapshot()
        client.restore(state)
    assert client.resent == 0, 'what is sent gets through'


def test_silent_agent_loses_control(processes: Processes, make_client: MakeClient) -> None:
    processes.fork_node('rocket_sim_node', 'simulator', num_envs=N, agent_lease=0.5)
    first = make_client()
    first.reset(1)
    second = make_client()
    second.reset(2)
    with pytest.raises(EnvironmentRestarted):
        first.step(actions(1)[0])


def test_computing_agent_keeps_control(
        processes: Processes, make_client: MakeClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('rocket_sim_node.wire.client.connection._KEEP_PERIOD', 0.2)
    processes.fork_node('rocket_sim_node', 'simulator', num_envs=N, agent_lease=3.0)
    first, second = make_client(), make_client(patience=6.0)
    first.reset(1)
    first.step(actions(1)[0])
    refused: list[Exception] = []

    def take_over() -> None:
        try:
            second.reset(2)
        except SimulatorBusy as error:
            refused.append(error)

    rival = threading.Thread(target=take_over)
    rival.start()
    while rival.is_alive():
        first.connection.keep()
        rival.join(0.05)
    assert refused
    world = make('rocket', num_envs=N)
    world.reset(1)
    world.step(actions(1)[0])
    assert_same(first.step(actions(1, 3)[0]), world.step(actions(1, 3)[0]))


def test_a_simulator_restarted_with_other_settings_is_refused_by_name(
        simulator: Process, processes: Processes, make_client: MakeClient) -> None:
    client = make_client(patience=30.0)
    client.reset(9)
    simulator.signal(signal.SIGKILL)
    simulator.wait(5.0)
    processes.fork_node('rocket_sim_node', 'simulator', num_envs=N, max_thrust=500000.0)
    with pytest.raises(EnvironmentRestarted):
        client.step(actions(1)[0])
    with pytest.raises(ValueError, match=r'max_thrust is 500000\.0, expected 470880\.0'):
        client.reset(9)


def test_restarted_simulator_is_noticed_and_restored(
        simulator: Process, processes: Processes, make_client: MakeClient) -> None:
    client = make_client(patience=30.0)
    client.reset(9)
    for action in actions(5):
        client.step(action)
    state = client.snapshot()
    expected = client.step(actions(1)[0])
    simulator.signal(signal.SIGKILL)
    simulator.wait(5.0)
    processes.fork_node('rocket_sim_node', 'simulator', num_envs=N)
    with pytest.raises(EnvironmentRestarted):
        client.step(actions(1)[0])
    client.restore(state)
    assert_same(client.step(actions(1)[0]), expected)


def test_stopped_simulator_costs_time_and_no_step(
        simulator: Process, make_client: MakeClient) -> None:
    client = make_client()
    world = make('rocket', num_envs=N)
    client.reset(1)
    world.reset(1)
    assert_same(client.step(actions(1)[0]), world.step(actions(1)[0]))
    simulator.signal(signal.SIGSTOP)
    timer = threading.Timer(1.0, lambda: simulator.signal(signal.SIGCONT))
    timer.start()
    for action in actions(20, seed=1):
        assert_same(client.step(action), world.step(action))
    timer.join()
    assert client.resent > 0


def test_an_action_before_the_release_is_flown(
        simulator: Process, make_client: MakeClient) -> None:
    """A service may overtake a topic: both have arrived when the simulator goes on."""
    client = make_client()
    client.reset(1)
    simulator.signal(signal.SIGSTOP)
    client.connection.ask(actions(1)[0])
    released = client.connection.release()
    time.sleep(0.3)
    simulator.signal(signal.SIGCONT)
    client.waiter.linger(released, 10.0)
    assert released()
    client.reset(1)  # the simulator has handled all that came before
    assert 'refused' not in simulator.output()


def test_a_missing_simulator_is_an_error_and_not_a_hang(make_client: MakeClient) -> None:
    with pytest.raises(WireTimeout, match='is it running'):
        make_client(patience=0.5).connect()


def test_client_may_start_first(processes: Processes, make_client: MakeClient) -> None:
    client = make_client()
    starter = threading.Timer(
        1.0, lambda: processes.fork_node('rocket_sim_node', 'simulator', num_envs=N))
    starter.start()
    client.reset(1)
    client.step(actions(1)[0])
    starter.join()


def still(client: Client, states: list[msg.RocketState]) -> bool:
    """Tell whether no state comes for half a second."""
    count = len(states)
    return not client.waiter.until(lambda: len(states) > count, 0.5)


def test_realtime_holds_the_action_and_cuts_the_engine(
        processes: Processes, make_client: MakeClient) -> None:
    process = processes.fork_node(
        'rocket_sim_node', 'simulator', num_envs=N, mode='realtime', action_timeout=0.3,
        realtime_factor=2.0, agent_lease=1.0)
    client = make_client()
    client.reset(1)
    states: list[msg.RocketState] = []
    client.node.create_subscription(msg.RocketState, 'state', states.append, qos.EVENTS)
    full = np.tile(np.float32([1, 0, 0]), (N, 1))
    client.step(full)
    assert client.waiter.until(lambda: any(s.throttle[0] == 1.0 for s in states), 10.0)
    assert client.waiter.until(lambda: states[-1].throttle[-1] == 0.0, 10.0)
    process.wait_for('engine cut', 10.0)
    # Silent for as long as the lease: no agent flies, so nothing moves.
    assert client.waiter.until(lambda: still(client, states), 10.0)
    steps = client.connection.step
    client.step(full)
    assert client.connection.step > steps + 1
    assert client.waiter.until(lambda: states[-1].throttle[0] == 1.0, 10.0)


def test_an_action_that_comes_late_is_not_flown_in_realtime(
        processes: Processes, make_client: MakeClient) -> None:
    processes.fork_node(
        'rocket_sim_node', 'simulator', num_envs=N, mode='realtime', action_timeout=60.0,
        agent_lease=60.0)
    client = make_client()
    client.reset(1)
    states: list[msg.RocketState] = []
    client.node.create_subscription(msg.RocketState, 'state', states.append, qos.EVENTS)
    speaker = Speaker(client)
    idle, full = (np.tile(np.float32([value, 0, 0]), (N, 1)) for value in (-1, 1))
    client.step(idle)
    late = client.connection.step
    while client.connection.step < late + 3:
        client.step(full)
    assert client.waiter.until(lambda: bool(states) and states[-1].throttle[-1] == 1.0, 10.0)
    speaker.say(idle, step=late - 1)
    speaker.expect_refusal(f'action: step: {late - 1}', 'expected ')
    assert states[-1].throttle[-1] == 1.0


def test_a_missing_answer_makes_the_client_compare_definitions(
        simulator: Process, make_client: MakeClient, monkeypatch: pytest.MonkeyPatch) -> None:
    client = make_client()
    client.connect()
    client.reset(0)
    simulator.signal(signal.SIGSTOP)
    client.connection._compare_at = 0.0

    def differ(*_: object) -> bool:
        raise DefinitionsDiffer('reward')

    monkeypatch.setattr('rocket_sim_node.wire.client.connection.check_definitions', differ)
    with pytest.raises(DefinitionsDiffer):
        client.step(actions(1)[0])
    simulator.signal(signal.SIGCONT)


def test_a_simulator_of_another_name_is_found_by_remapped_services(
        processes: Processes, make_client: MakeClient, make_node: Callable[..., Any],
        monkeypatch: pytest.MonkeyPatch) -> None:
    """Without them, the agent says which to remap."""
    processes.fork_node('rocket_sim_node', 'simulator', ('__node:=falcon',), num_envs=N)
    client = make_client(patience=60.0)
    client.connect()
    monkeypatch.setattr(client.connection, '_options', ConnectionOptions(patience=1.0))
    with pytest.raises(WireTimeout) as error:
        client.reset(0)
    advice = '--ros-args -r /simulator/reset:=/NAME/reset'
    assert str(error.value).endswith(
        'no node offers /simulator/reset; if the simulator has another name, remap the service: '
        + advice)
    remap = [
        word for name in ('reset', 'snapshot', 'restore', 'release')
        for word in ('-r', f'simulator/{name}:=falcon/{name}')]
    node, executor = make_node(cli_args=['--ros-args', *remap])
    world = make('rocket', num_envs=N)
    with Client(node, executor, ConnectionOptions()) as client:
        np.testing.assert_array_equal(client.reset(3), world.reset(3))
        assert_same(client.step(actions(1)[0]), world.step(actions(1)[0]))
        state = client.snapshot()
        assert state == world.snapshot()
        np.testing.assert_array_equal(client.restore(state), world.restore(state))
    with Client(node, executor, ConnectionOptions()) as other:  # it was released
        other.reset(0)


@pytest.mark.parametrize(('kind', 'fields', 'code'), [
    (srv.Reset, {'agent': 1, 'seed': 3}, srv.Reset.Response.OK),
    (srv.Snapshot, {'agent': 1}, srv.Snapshot.Response.BUSY),
    (srv.Restore, {'agent': 1, 'state': [1]}, srv.Restore.Response.INVALID),
    (srv.Release, {'agent': 1}, srv.Release.Response.BUSY)])
def test_names_of_before_1_0_answer_as_the_new_ones_do(
        simulator: Process, make_client: MakeClient, kind: Any, fields: dict[str, Any],
        code: int) -> None:
    client = make_client()
    client.connect()
    name = kind.__name__.lower()
    answers = []
    for service in (f'simulator/{name}', name, name):
        caller = client.node.create_client(kind, service)
        assert client.waiter.until(caller.service_is_ready, 10.0)
        future = caller.call_async(kind.Request(**fields))
        assert client.waiter.until(future.done, 10.0)
        answers.append((future.result().code, future.result().message))
    assert [answer[0] for answer in answers] == [code] * 3
    assert answers[0] == answers[1] == answers[2]
    assert simulator.output().count(f'service /{name} is deprecated') == 1  # at the first call


@pytest.mark.parametrize('name', ['simulator/reset', 'reset'])
def test_services_can_be_called_by_hand(
        simulator: Process, make_client: MakeClient, name: str) -> None:
    """By their names below the node's, and by their deprecated names of before 1.0."""
    client = make_client()
    client.connect()
    node = client.node
    reset = node.create_client(srv.Reset, name)

    def call(**fields: int) -> srv.Reset.Response:
        assert client.waiter.until(reset.service_is_ready, 10.0)
        future = reset.call_async(srv.Reset.Request(**fields))
        assert client.waiter.until(future.done, 10.0)
        return future.result()

    response = call(seed=3, agent=1)
    assert response.code == response.OK
    assert len(response.observation) == N * 15
    nobody = call(seed=3)
    assert nobody.code in (nobody.BUSY, nobody.INVALID)
    warned = 'service /reset is deprecated and will be removed in 2.0: call /simulator/reset'
    assert simulator.output().count(warned) == (name == 'reset')
    assert 'agent' in nobody.message


def test_state_holds_the_last_and_first_samples_of_episodes(
        simulator: Process, make_client: MakeClient) -> None:
    client = make_client()
    states: list[msg.RocketState] = []
    client.node.create_subscription(msg.RocketState, 'state', states.append, qos.EVENTS)
    client.connect()
    client.waiter.until(lambda: client.node.count_publishers('state') > 0, 10.0)
    world = make('rocket', num_envs=N)
    client.reset(2)
    world.reset(2)
    ended: list[int] = []
    heights = []
    for _ in range(450):
        info = client.step(np.tile(np.float32([-1, 0, 0]), (N, 1)))[4]
        ended += info['episodes'].row.tolist()
        world.step(np.tile(np.float32([-1, 0, 0]), (N, 1)))
        heights.append(world.position[1, 0])
    client.close()
    client.waiter.until(lambda: any(max(s.step) >= 450 for s in states), 20.0)
    row = np.concatenate([s.row for s in states])
    step = np.concatenate([s.step for s in states])
    outcome = np.concatenate([s.outcome for s in states])
    z = np.concatenate([np.reshape(s.position, (-1, 3))[:, 2] for s in states])
    assert set(row.tolist()) == {0, 1, 2, 3}
    assert (outcome != msg.RocketState.NONE).sum() == sum(r < 4 for r in ended) > 0
    last = np.flatnonzero((row == 0) & (outcome != msg.RocketState.NONE))[0]
    assert z[last] <= 5.2
    again = np.flatnonzero((row == 0) & (step == step[last]))
    assert len(again) == 2
    assert z[again[1]] == 200.0
    flying = (row == 0) & (outcome == msg.RocketState.NONE) & (step > 0)
    np.testing.assert_array_equal(z[flying], [heights[int(s) - 1] for s in step[flying]])
