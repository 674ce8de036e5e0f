# SPDX-License-Identifier: Apache-2.0
"""Fleets of simulators: flights do not depend on which simulators join or leave."""
from __future__ import annotations

import functools
import signal
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rocket_msgs import msg
from support.processes import Process
from support.processes import Processes
from support.processes import wait_until

from rocket_sim_node.wire.client.connection import ConnectionOptions
from rocket_sim_node.wire.client.fleet import SimulatorFleet
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.wire.node.polling import MessageSubscription
from rocket_sim_node.wire.node.polling import PolledClient
from rocket_sim_node.wire.node.waiting import WireTimeout
from rocket_sim_node.worlds import make
from rocket_sim_node.worlds.jobs import Act
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import Restore
from rocket_sim_node.worlds.jobs import Results
from rocket_sim_node.worlds.jobs import SerialFleet
from rocket_sim_node.worlds.jobs import Snapshot

N, STEPS = 4, 150
MakeFleet = Callable[..., SimulatorFleet]


@pytest.fixture
def make_fleet(make_node: Callable[..., Any]) -> MakeFleet:
    """Fleets of the simulators of this test."""
    def make_one(pattern: str = '/sim_*', patience: float = 20.0) -> SimulatorFleet:
        return SimulatorFleet(*make_node(), ConnectionOptions(0.1, patience), 1, pattern)

    return make_one


def simulator(processes: Processes, number: int, **parameters: object) -> Process:
    """Start a simulator in a namespace of its own."""
    return processes.fork_node(
        'rocket_sim_node', 'simulator', remap=(f'__ns:=/sim_{number}',),
        **{'num_envs': N, **parameters})


def actions(seed: int) -> np.ndarray:
    """Random actions `(STEPS, N, 3)`."""
    return np.random.default_rng(seed).uniform(-1, 1, (STEPS, N, 3)).astype(np.float32)


def fall(seed: int) -> Job[tuple[np.ndarray, float, bytes]]:
    """Fly random actions; return all observations, the sum of rewards and the end.

    Some steps are answered as a whole, others by the observation first.
    """
    seen, rewards = [(yield Reset(seed, {'level': 7}))], list[float]()

    def record(results: Results) -> None:
        rewards.append(float(results[0].sum()))

    for number, action in enumerate(actions(seed)):
        if number % 4:
            observation = yield Act(action, record)
        else:
            observation, *results = yield action
            record(results)
        seen.append(observation)
    end = yield Snapshot()
    assert len(rewards) == STEPS
    return np.stack(seen), sum(rewards), end


def go_on(state: bytes, seed: int) -> Job[np.ndarray]:
    """Fly on from a snapshot."""
    observation = yield Restore(state)
    for action in actions(seed):
        observation, *_ = yield action
    return observation


def flown(fleet: SimulatorFleet | SerialFleet, seeds: range, poll: Callable[[], None]) -> list:
    """Return the results of flights, and of flights that continue from their ends."""
    first = list(fleet.fly([functools.partial(fall, seed) for seed in seeds], poll))
    second = list(fleet.fly([
        functools.partial(go_on, state, seed)
        for (_, _, state), seed in zip(first, seeds, strict=True)], poll))
    return [(seen, total, end) for (seen, total, _), end in zip(first, second, strict=True)]


def assert_same_flights(ours: list, theirs: list) -> None:
    """Assert that two lists of `flown` are the same, bit for bit."""
    assert len(ours) == len(theirs)
    for one, other in zip(ours, theirs, strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)


def in_process(seeds: range) -> list:
    """Return the results of the same flights without ROS."""
    return flown(SerialFleet(make('rocket', num_envs=N)), seeds, lambda: None)


def fly_until(words: str, fleet: SimulatorFleet, capfd: pytest.CaptureFixture[str]) -> str:
    """Fly until the log holds a text, and return the log."""
    text, end = '', time.monotonic() + 20.0
    while words not in text and time.monotonic() < end:
        list(fleet.fly([functools.partial(fall, 1)]))
        text += capfd.readouterr().err
    return text


def compute(seconds: float) -> Job[None]:
    """Fly a few steps, then compute before the job ends."""
    observation = yield Reset(1)
    for action in actions(1)[:10]:
        observation, *_ = yield action
    assert observation.shape[0] == N
    time.sleep(seconds)


def begin_again(seed: int) -> Job[None]:
    """Only reset."""
    for number in range(40):
        yield Reset(seed + number)


@pytest.mark.parametrize('other', [fall, begin_again])
def test_a_simulator_is_not_silent_while_the_agent_computes(
    processes: Processes, make_fleet: MakeFleet, other: Callable[[int], Job[Any]],
) -> None:
    """Its answer has arrived, or is on its way, and nobody has listened to it."""
    for number in range(2):
        simulator(processes, number)
    reports: list[str] = []
    with make_fleet() as fleet:
        while len([*fleet._membership]) < 2:
            list(fleet.fly([functools.partial(fall, 1)]))
        list(fleet.fly(
            [functools.partial(compute, 2.5), functools.partial(other, 1)], report=reports.append))
    assert reports == []


def test_flights_over_many_simulators_are_those_in_process(
    processes: Processes, make_fleet: MakeFleet,
) -> None:
    for number in range(3):
        simulator(processes, number)
    with make_fleet() as fleet:
        assert_same_flights(flown(fleet, range(5), lambda: None), in_process(range(5)))


def test_a_closed_fleet_releases_its_simulators_and_endpoints(
        processes: Processes, make_node: Callable[..., Any]) -> None:
    simulator(processes, 0)
    node, executor = make_node()

    def of_the_simulator() -> list[str]:
        names = [
            *(p.topic_name for p in node.publishers), *(s.topic_name for s in node.subscriptions),
            *(client.srv_name for client in node.clients),
            *(one.topic for one in MessageSubscription._open
              if isinstance(one, MessageSubscription) and one._node is node),
            *(one.srv_name for one in PolledClient._open if isinstance(one, PolledClient)
              and one._node is node)]
        return [name for name in names if name.startswith('/sim_0')]

    with SimulatorFleet(node, executor, ConnectionOptions(0.1, 20.0), 1, '/sim_*') as fleet:
        list(fleet.fly([functools.partial(fall, 1)]))
        assert {'/sim_0/action', '/sim_0/world', '/sim_0/simulator/reset'} <= set(
            of_the_simulator())
    assert of_the_simulator() == []
    fleet.close()
    with SimulatorFleet(*make_node(), ConnectionOptions(0.1, 15.0), 2, '/sim_*') as other:
        assert len(list(other.fly([functools.partial(fall, 1)]))) == 1


def test_simulators_may_be_killed_ended_stopped_and_added(
        processes: Processes, make_fleet: MakeFleet) -> None:
    """One is killed, one ends in order, one is stopped and continued, one joins late."""
    running = [simulator(processes, number) for number in range(3)]
    timers: list[threading.Timer] = []

    def later(seconds: float, act: Callable[[], object]) -> None:
        timers.append(threading.Timer(seconds, act))
        timers[-1].start()

    polls = 0

    def poll() -> None:
        nonlocal polls
        polls += 1
        if polls == 200:
            running[0].signal(signal.SIGKILL)
            later(0.2, lambda: simulator(processes, 3))
            later(1.0, lambda: simulator(processes, 0))
        elif polls == 400:
            running[1].signal(signal.SIGTERM)
        elif polls == 800:
            running[2].signal(signal.SIGSTOP)
            later(3.0, lambda: running[2].signal(signal.SIGCONT))

    seeds = range(24)
    with make_fleet() as fleet:
        fleet.connect()
        result = flown(fleet, seeds, poll)
        for timer in timers:
            timer.join()
    assert polls > 800
    assert_same_flights(result, in_process(seeds))


def test_a_simulator_of_another_world_is_not_used(
    processes: Processes, make_fleet: MakeFleet, capfd: pytest.CaptureFixture[str],
) -> None:
    simulator(processes, 0)
    with make_fleet() as fleet:
        fleet.connect()
        simulator(processes, 1, num_envs=N + 1).wait_for('waiting for an agent', 30.0)
        text = fly_until('is not used', fleet, capfd)
    assert '/sim_1 is not used: its num_envs is 5, expected 4' in text


def test_a_simulator_restarted_with_another_world_is_no_longer_used(
    processes: Processes, make_fleet: MakeFleet, capfd: pytest.CaptureFixture[str],
) -> None:
    first = simulator(processes, 0)
    simulator(processes, 1)
    polls = 0

    def poll() -> None:
        nonlocal polls
        polls += 1
        if polls == 200:
            first.signal(signal.SIGKILL)
            simulator(processes, 0, num_envs=N + 1)

    seeds = range(16)
    with make_fleet() as fleet:
        assert '/sim_0 has joined' in fly_until('simulators: 2', fleet, capfd)
        result = flown(fleet, seeds, poll)
        text = fly_until('it is no longer used', fleet, capfd)
    assert_same_flights(result, in_process(seeds))
    assert ('/sim_0 restarted with another world: num_envs is 5, expected 4; it is no longer used'
            in text)


@pytest.mark.parametrize(('namespace', 'pattern'), [('', ''), ('/sim_0', '/sim_*')])
def test_world_descriptions_of_other_nodes_change_nothing(
    processes: Processes, make_fleet: MakeFleet, make_node: Callable[..., Any],
    namespace: str, pattern: str,
) -> None:
    processes.fork_node(
        'rocket_sim_node', 'simulator', (f'__ns:={namespace}',) if namespace else (), num_envs=N)
    node, _ = make_node()
    publisher = node.create_publisher(msg.World, f'{namespace}/world', qos.WORLD)
    spec = make('rocket', num_envs=N).spec
    wrong = [
        conversion.world_to_message(spec, 1, 0, msg.World.LOCKSTEP),
        conversion.world_to_message(
            make('rocket', num_envs=N + 1).spec, 2, 0, msg.World.LOCKSTEP),
        conversion.world_to_message(make('lunar_lander').spec, 3, 0, msg.World.LOCKSTEP),
        conversion.world_to_message(spec, 4, 0, msg.World.REALTIME)]
    wrong.append(conversion.world_to_message(spec, 5, 0, msg.World.LOCKSTEP))
    wrong[-1].dt = float('nan')
    polls = 0

    def poll() -> None:
        nonlocal polls
        polls += 1
        if polls % 60 == 0 and wrong:
            publisher.publish(wrong.pop())

    seeds = range(8)
    with make_fleet(pattern) as fleet:
        fleet.connect()
        wait_until(lambda: publisher.get_subscription_count() > 0, 10.0)
        result = flown(fleet, seeds, poll)
    assert not wrong
    assert_same_flights(result, in_process(seeds))


def test_a_participant_that_described_itself_first_is_not_the_simulator(
    processes: Processes, make_fleet: MakeFleet, make_node: Callable[..., Any],
) -> None:
    """It describes the world and publishes observations, as a simulator does, without end."""
    node, _ = make_node()
    publisher = node.create_publisher(msg.World, 'world', qos.WORLD)
    observations = node.create_publisher(msg.Observation, 'observation', qos.STREAM)
    forged = conversion.world_to_message(
        make('rocket', num_envs=N).spec, 1, 0, msg.World.LOCKSTEP)
    polls = 0

    def poll() -> None:
        nonlocal polls
        polls += 1
        if polls % 20 == 0:
            publisher.publish(forged)

    publisher.publish(forged)
    seeds = range(4)
    with make_fleet('') as fleet:
        fleet.connect()
        wait_until(lambda: observations.get_subscription_count() > 0, 10.0)
        processes.fork_node('rocket_sim_node', 'simulator', num_envs=N)
        result = flown(fleet, seeds, poll)
    assert_same_flights(result, in_process(seeds))


def test_a_real_time_simulator_is_not_used(
    processes: Processes, make_fleet: MakeFleet, capfd: pytest.CaptureFixture[str],
) -> None:
    simulator(processes, 0)
    simulator(processes, 1, mode='realtime').wait_for('waiting for an agent', 30.0)
    with make_fleet() as fleet:
        text = fly_until('is not used', fleet, capfd)
    assert '/sim_1 is not used: its mode is realtime, expected lockstep' in text


@pytest.mark.parametrize('namespace', ['', '/b'])
def test_a_second_simulator_is_used_beside_that_of_the_namespace(
    processes: Processes, make_node: Callable[..., Any], capfd: pytest.CaptureFixture[str],
    namespace: str,
) -> None:
    """The second one may be there first, and others are not used."""
    for inner in (f'{namespace}/other', f'{namespace}/second'):
        processes.fork_node(
            'rocket_sim_node', 'simulator', (f'__ns:={inner}',), num_envs=N
        ).wait_for('waiting for an agent', 30.0)
    node, executor = make_node(namespace)
    with SimulatorFleet(node, executor, ConnectionOptions(0.1, 20.0), 1, second='second') as fleet:
        processes.fork_node(
            'rocket_sim_node', 'simulator', (f'__ns:={namespace or "/"}',), num_envs=N)
        text = fly_until('; simulators: 2', fleet, capfd)
        assert_same_flights(flown(fleet, range(3), lambda: None), in_process(range(3)))
        names = [worker.connection.name for worker in fleet._membership]
    assert names == ['simulator', f'{namespace}/second']
    assert f'{namespace}/second has joined' in text and 'other' not in text


def test_a_second_simulator_of_another_world_is_not_used(
    processes: Processes, make_node: Callable[..., Any], capfd: pytest.CaptureFixture[str],
) -> None:
    processes.fork_node(
        'rocket_sim_node', 'simulator', ('__ns:=/second',), num_envs=N, max_thrust=500_000.0
    ).wait_for('waiting for an agent', 30.0)
    node, executor = make_node()
    with SimulatorFleet(node, executor, ConnectionOptions(0.1, 20.0), 1, second='second') as fleet:
        processes.fork_node('rocket_sim_node', 'simulator', num_envs=N)
        assert fleet.spec == make('rocket', N).spec
        text = fly_until('is not used', fleet, capfd)
    assert '/second is not used: its max_thrust is 500000.0, expected 470880.0' in text


@pytest.mark.parametrize(('second', 'pattern', 'message'), [
    ('/b', '', "second_simulator: got '/b', expected a word"),
    ('b', '/sim_*', r"second_simulator: got 'b', expected none with simulators '/sim_\*'")])
def test_an_invalid_second_simulator_is_refused(
        make_node: Callable[..., Any], second: str, pattern: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SimulatorFleet(*make_node(), ConnectionOptions(), 1, pattern, second)


def test_a_pattern_without_its_slash_is_refused(make_fleet: MakeFleet) -> None:
    with pytest.raises(ValueError, match=r"simulators: got 'sim_\*', expected .* begin with /"):
        make_fleet(pattern='sim_*')


def test_a_missing_simulator_is_a_timeout(make_fleet: MakeFleet) -> None:
    fleet = make_fleet(patience=1.0)
    with pytest.raises(WireTimeout, match=r'simulators of /sim_\*/world'):
        fleet.connect()
