# SPDX-License-Identifier: Apache-2.0
"""A rocket without commands is stopped; only its agent can send commands."""
from __future__ import annotations

import ast
import threading
import time
from collections.abc import Callable
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import ListParameters
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rocket_msgs import msg
from rocket_msgs import srv
from rosgraph_msgs.msg import Clock
from support.invalid_data.rubbish import Rubbish
from support.processes import Process
from support.processes import Processes
from support.processes import wait_until
from support.training.rollouts import assert_same

from rocket_sim_node import wire
from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.client.connection import Connection
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.worlds import make

N, STRANGER = 4, 0xBAD
MakeClient = Callable[..., Client]
REALTIME = {'mode': 'realtime', 'action_timeout': 1.0, 'agent_lease': 30.0}
FULL = np.tile(np.float32([1, 0, 0]), (N, 1))
NODES = {
    'simulator': ('rocket_sim_node', {'num_envs', 'mode', 'dt', 'max_thrust', 'agent_lease'}),
    'rerun_recorder': ('rocket_sim_node', {'output', 'web_host', 'rows', 'max_steps'}),
    'bag_recorder': ('rocket_sim_node', {'output', 'topics', 'compression'}),
    'ros_bridge': ('rocket_sim_node', {'rows', 'max_rate', 'frame_prefix'}),
    'ppo_agent': ('ppo_agent_node', {'mode', 'run_dir', 'patience', 'clip_range'}),
    'random_pilot': ('ppo_agent_node', {'seed', 'level', 'episodes', 'patience'}),
    'expert_pilot': ('ppo_agent_node', {'seed', 'level', 'episodes', 'patience'}),
    'evaluate': ('ppo_agent_node', {'pilot', 'policy', 'episodes', 'patience'}),
    'action_server': ('ppo_agent_node', {'use_sim_time'}),
    'watch': ('ppo_agent_node', {'use_sim_time'})}
"""by name: the package, and some of the parameters that it has once it is ready. keyboard_pilot is
missing: while it waits for a key, it answers no calls about its parameters."""


def call(client: Client, kind: Any, name: str, **fields: Any) -> Any:
    """Return the response of a service.

    A server may discover the request before it discovers the reader of the response, and then
    drops the response: the call is repeated.
    """
    service = client.node.create_client(kind, name)
    assert client.waiter.until(service.service_is_ready, 60.0), name
    for _ in range(12):
        future = service.call_async(kind.Request(**fields))
        if client.waiter.until(future.done, 5.0):
            return future.result()
        service.remove_pending_request(future)
    raise AssertionError(f'{name} does not answer')


def values_of(report: DiagnosticArray) -> dict[str, str]:
    """Return the values of a report, by name."""
    return {item.key: item.value for item in report.status[0].values}


def moment(report: DiagnosticArray) -> float:
    """Return when a report was made, s of the clock of the day."""
    return report.header.stamp.sec + 1e-9 * report.header.stamp.nanosec


class Watch:
    """Receives the diagnostics of a simulator and the states of its rockets."""

    def __init__(self, client: Client) -> None:
        self.client, self.status, self.throttle = client, DiagnosticStatus(), 0.0
        self.reports: list[DiagnosticArray] = []
        self.session = self.step = 0
        client.node.create_subscription(
            DiagnosticArray, '/diagnostics', self._on_diagnostics, qos.EVENTS)
        client.node.create_subscription(msg.RocketState, 'state', self._on_state, qos.EVENTS)
        self.until(lambda: client.node.count_publishers('/diagnostics') > 1)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        # Clients report as well, once messages to them are dropped, as on a busy machine.
        if message.status[0].hardware_id.endswith('simulator'):
            self.status = message.status[0]
            self.reports.append(message)

    def _on_state(self, message: msg.RocketState) -> None:
        self.session, self.step, self.throttle = (
            message.session, message.step[-1], message.throttle[-1])

    def __getitem__(self, key: str) -> str:
        return values_of(self.reports[-1]).get(key, '') if self.reports else ''

    def until(self, done: Callable[[], bool]) -> None:
        assert self.client.waiter.until(done, 20.0), self.status

    def passes(self, steps: int) -> None:
        """Wait until the simulator has made so many steps."""
        goal = self.step + steps
        self.until(lambda: self.step >= goal)


def realtime(
    processes: Processes, make_client: MakeClient, **options: object,
) -> tuple[Process, Client, Watch]:
    """Return a real-time simulator, a client that has not reset it yet, and a `Watch`.

    The engine is cut if an agent sends no action soon after its reset.
    """
    process = processes.fork_node(
        'rocket_sim_node', 'simulator', num_envs=N, **{**REALTIME, **options})
    client = make_client()
    client.connect()
    return process, client, Watch(client)


@pytest.fixture
def jumping_clock(make_node: Callable[..., Any]) -> Iterator[None]:
    """A `/clock` that jumps hours ahead and back."""
    publisher = make_node()[0].create_publisher(Clock, '/clock', 1)
    done = threading.Event()

    def jump() -> None:
        number = 0
        while not done.wait(0.05):
            number += 1
            publisher.publish(Clock(clock=Time(sec=number % 2 * 7200 + number % 5)))

    thread = threading.Thread(target=jump)
    thread.start()
    yield
    done.set()
    thread.join()


@pytest.mark.parametrize('sim_time', [False, True])
def test_the_engine_is_cut_without_actions_and_follows_new_ones(
        processes: Processes, make_client: MakeClient, jumping_clock: None,
        sim_time: bool) -> None:
    """The watchdog uses the steady clock: jumps of ROS time have no effect."""
    process, client, watch = realtime(processes, make_client, use_sim_time=sim_time)
    client.reset(1)
    for cut in (1, 2):
        for _ in range(10):
            client.step(FULL)
        watch.until(lambda: watch.throttle == 1.0)
        watch.until(lambda: watch.throttle == 0.0)
        watch.until(lambda: watch['engine cuts'] == str(cut))  # noqa: B023
        assert watch.status.level == DiagnosticStatus.ERROR
        assert 'engine cut' in watch.status.message
        watch.passes(10)  # it falls on
    assert process.output().count('engine cut') == 2
    client.step(FULL)
    watch.until(lambda: watch.throttle == 1.0)
    assert process.output().count('actions arrive again') == 2
    watch.until(lambda: watch.status.level == DiagnosticStatus.ERROR)  # cut a third time
    client.close()
    watch.until(lambda: watch.status.level == DiagnosticStatus.OK)
    assert watch['agent'] == 'nobody'


def test_an_agent_that_sends_no_action_after_its_reset_is_reported(
        processes: Processes, make_client: MakeClient) -> None:
    """It died after its reset, or its actions are lost."""
    process, client, watch = realtime(processes, make_client)
    watch.until(lambda: watch['engine cuts'] == '0')
    assert watch.status.level == DiagnosticStatus.OK  # no agent flies
    client.reset(1)
    watch.until(lambda: watch['engine cuts'] == '1')
    assert watch.status.level == DiagnosticStatus.ERROR
    watch.passes(50)
    assert process.output().count('engine cut') == 1
    client.close()
    watch.until(lambda: watch.status.level == DiagnosticStatus.OK)


def test_a_real_time_agent_that_only_computes_loses_control(
        processes: Processes, make_client: MakeClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its engine is cut, and another agent may take over after the lease."""
    monkeypatch.setattr('rocket_sim_node.wire.client.connection._KEEP_PERIOD', 0.02)
    lease = 3.0
    _, client, watch = realtime(processes, make_client, agent_lease=lease)
    other = make_client()
    client.reset(1)
    begun = time.monotonic()
    client.step(FULL)
    over = threading.Event()

    def compute() -> None:
        while not over.wait(0.01):
            client.connection.keep()

    thread = threading.Thread(target=compute)
    thread.start()
    try:
        watch.until(lambda: watch['engine cuts'] == '1')
        watch.until(lambda: watch.throttle == 0.0)
        other.reset(2)
        assert time.monotonic() - begun >= lease
    finally:
        over.set()
        thread.join()
    watch.until(lambda: watch['agent'] == str(other.connection.agent))
    other.step(FULL)
    watch.until(lambda: (watch.session, watch.throttle) == (other.session, 1.0))


@contextmanager
def flood(connection: Connection) -> Iterator[None]:
    """Send invalid messages as a connection's agent, more than a simulator can handle."""
    source, over = Rubbish(connection, 1), threading.Event()
    made = [source.rubbish() for _ in range(1000)]

    def send() -> None:
        while not over.wait(0.0005):
            for index in source.rng.integers(len(made), size=40).tolist():
                connection._publisher.publish(made[index])

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def test_a_flood_delays_neither_real_time_steps_nor_the_watchdog(
        processes: Processes, make_client: MakeClient) -> None:
    processes.fork_node('rocket_sim_node', 'simulator', num_envs=N, **REALTIME)
    client, stranger = make_client(), make_client(agent=STRANGER)
    client.reset(1)
    watch = Watch(client)
    publisher = stranger.connection._publisher
    assert stranger.waiter.until(lambda: publisher.get_subscription_count() > 0, 20.0)
    stranger.connection.session = client.session

    def lit() -> bool:
        client.step(FULL)  # some get through
        return watch.throttle == 1.0

    with flood(stranger.connection):
        watch.until(lit)
        watch.until(lambda: int(watch['refused on action'] or 0) > 0)
        first = watch.reports[-1]
        watch.until(lambda: int(watch['engine cuts'] or 0) > 0 and watch.throttle == 0.0)
        watch.until(lambda: moment(watch.reports[-1]) - moment(first) > 4.0)
    last = watch.reports[-1]
    steps, refused = (
        int(values_of(last)[key]) - int(values_of(first)[key])
        for key in ('step', 'refused on action'))
    assert refused > 5 * steps, 'no flood'
    rate = steps * client.spec.dt / (moment(last) - moment(first))
    assert 0.5 < rate < 1.5, f'{rate:.2f} simulated seconds a second'


def test_slow_motion_alone_does_not_cut_the_engine(
        processes: Processes, make_client: MakeClient) -> None:
    """The next action can only come after a step, 0.67 s here."""
    process = processes.fork_node(
        'rocket_sim_node', 'simulator', num_envs=N, mode='realtime', action_timeout=0.3,
        realtime_factor=0.03)
    client = make_client()
    client.reset(1)
    for _ in range(5):
        client.step(FULL)
    assert 'engine cut' not in process.output()
    process.wait_for('engine cut', 10.0)  # when no more come


def test_a_repeated_action_does_not_count_as_a_new_one(
        processes: Processes, make_client: MakeClient) -> None:
    """An agent that receives no answers repeats it, or the network duplicates and delays it."""
    process, client, watch = realtime(processes, make_client)
    blind = client.node.create_publisher(msg.Action, 'action', qos.STREAM)
    watch.until(lambda: blind.get_subscription_count() > 0)
    client.reset(1)
    order = msg.Action(
        session=client.connection.session, step=client.connection.step,
        agent=client.connection.agent, continuous=conversion.to_sequence(FULL, 'f4'))

    def cut() -> bool:
        blind.publish(order)
        return watch['engine cuts'] == '1'

    watch.until(cut)
    for _ in range(20):
        blind.publish(order)
        watch.passes(2)
        assert watch.throttle == 0.0
    watch.until(lambda: int(watch['repeated actions']) > 20)
    assert 'actions arrive again' not in process.output()
    client.step(FULL)  # the same once more, but answered with what is seen now
    client.step(FULL)
    watch.until(lambda: watch.throttle == 1.0)


@pytest.mark.parametrize('mode', ['lockstep', 'realtime'])
def test_a_second_agent_cannot_take_over_in_flight(
        processes: Processes, make_client: MakeClient, mode: str) -> None:
    options = {**REALTIME, 'action_timeout': 5.0} if mode == 'realtime' else {}
    processes.fork_node('rocket_sim_node', 'simulator', num_envs=N, **options)
    client, world = make_client(), make('rocket', num_envs=N)
    client.reset(1)
    world.reset(1)
    watch = Watch(client)
    client.step(FULL)
    world.step(FULL)
    node, session = client.node, client.session
    publisher = node.create_publisher(msg.Action, 'action', qos.STREAM)
    watch.until(lambda: publisher.get_subscription_count() > 0)
    stolen = msg.Action(session=session, step=client.connection.step, agent=STRANGER)
    stolen.continuous = conversion.to_sequence(-FULL, 'f4')
    state = conversion.to_sequence(np.frombuffer(world.snapshot(), np.uint8), 'u1')
    requests = {
        'reset': (srv.Reset, {'seed': 1}), 'restore': (srv.Restore, {'state': state}),
        'snapshot': (srv.Snapshot, {'session': session, 'step': client.connection.step}),
        'release': (srv.Release, {})}
    for name, (kind, fields) in requests.items():
        service = node.create_client(kind, f'simulator/{name}')
        watch.until(service.service_is_ready)
        future = service.call_async(kind.Request(agent=STRANGER, **fields))
        watch.until(future.done)
        assert future.result().code == future.result().BUSY
        assert str(STRANGER) in future.result().message
        watch.until(lambda: watch[f'refused on {name}'] == '1')  # noqa: B023

    def refused() -> bool:
        publisher.publish(stolen)  # the first may come before the reader knows of us
        return int(watch['refused on action'] or 0) >= 3

    watch.until(refused)
    assert watch['agent'] == str(client.connection.agent)
    assert watch['session'] == str(session)
    if mode == 'lockstep':
        assert_same(client.step(FULL), world.step(FULL))
        assert client.snapshot() == world.snapshot()
    else:
        client.step(FULL)
        watch.passes(3)
        assert (watch.session, watch.throttle) == (session, 1.0)


def test_a_lease_shorter_than_the_watchdog_is_refused(processes: Processes) -> None:
    process = processes.fork_node(
        'rocket_sim_node', 'simulator', mode='realtime', action_timeout=1.0, agent_lease=0.5)
    assert process.wait(30.0) == 2
    assert ('agent_lease: got 0.5 s, expected at least action_timeout and 2.5 steps, 1 s: '
            in process.output())


def test_no_parameter_can_be_changed_after_start(
        processes: Processes, make_client: MakeClient, tmp_path: Path) -> None:
    """A client keeps control meanwhile: the other nodes wait, and serve their parameters."""
    processes.fork_node('rocket_sim_node', 'simulator', num_envs=N, agent_lease=600.0)
    client = make_client()
    client.reset(1)
    waits = {'patience': 600.0}  # for control, until all nodes have been examined
    given = {
        'ppo_agent': {'run_dir': tmp_path / 'run', **waits},
        'evaluate': {'pilot': 'random', **waits}, 'random_pilot': waits, 'expert_pilot': waits,
        'bag_recorder': {'output': tmp_path / 'bag', 'topics': 'world'}}
    for name, (package, _) in NODES.items():
        if name != 'simulator':
            processes.fork_node(package, name, **given.get(name, {}))

    def names(node: str) -> set[str]:
        return set(call(client, ListParameters, f'/{node}/list_parameters').result.names)

    for name, (_, some) in NODES.items():
        wait_until(lambda: names(name) >= some, 60.0, processes.logs)  # noqa: B023
        wanted = [
            Parameter(key, value=value).to_parameter_msg()
            for key in sorted({*names(name), 'unheard_of'} - {'use_sim_time'})
            for value in (1, 2.5, True, 'lockstep', [1, 2], [0.5], ['a'])]
        results = call(
            client, SetParameters, f'/{name}/set_parameters', parameters=wanted).results
        for parameter, result in zip(wanted, results, strict=True):
            assert not result.successful, (name, parameter)
            assert 'read-only' in result.reason or parameter.name == 'unheard_of', result.reason


def test_use_sim_time_can_be_set_and_does_not_stop_the_simulation(
        processes: Processes, make_client: MakeClient) -> None:
    processes.fork_node('rocket_sim_node', 'simulator', num_envs=N, **REALTIME)
    client = make_client()
    client.reset(1)
    watch = Watch(client)
    answer = call(client, SetParameters, '/simulator/set_parameters', parameters=[
        Parameter('use_sim_time', value=True).to_parameter_msg()])
    assert answer.results[0].successful
    for _ in range(5):
        client.step(FULL)
    watch.passes(5)


def test_commands_beyond_limits_are_clipped_and_counted_in_real_time(
        processes: Processes, make_client: MakeClient) -> None:
    process = processes.fork_node('rocket_sim_node', 'simulator', num_envs=N, **REALTIME)
    client = make_client()
    client.reset(1)
    watch = Watch(client)
    wild = FULL.copy()
    wild[:, 0], wild[2, 1] = 5.0, -9.0
    client.step(wild)
    watch.until(lambda: watch.throttle == 1.0)
    watch.until(lambda: watch['clipped throttle'] != '0' and bool(watch['clipped throttle']))
    times = int(watch['clipped actions'])
    assert int(watch['clipped throttle']) == N * times
    assert int(watch['clipped rcs_x']) == times
    assert watch['clipped rcs_z'] == '0'
    assert watch['last clipped'] == "row 3, 'throttle' is 5, expected -1 to 1"
    assert 'clipped: row 3' in process.output()
    client.close()
    watch.until(lambda: watch.status.level == DiagnosticStatus.OK)


def test_commands_beyond_limits_are_flown_as_in_process_and_counted_in_lockstep(
        processes: Processes, make_client: MakeClient) -> None:
    processes.fork_node('rocket_sim_node', 'simulator', num_envs=N)
    client, world = make_client(), make('rocket', num_envs=N)
    client.reset(1)
    world.reset(1)
    rng, expected = np.random.default_rng(3), np.zeros(3, int)
    for scale in (0.5, 2.0, 1e20, 1e300):
        action = rng.normal(0, scale, (N, 3))
        sent = action if scale > 1e30 else action.astype(np.float32)
        assert_same(client.step(sent), world.step(sent))
        expected += (np.abs(sent) > 1).sum(axis=0)
    watch = Watch(client)
    for axis, count in zip(('throttle', 'rcs_x', 'rcs_z'), expected.tolist(), strict=True):
        watch.until(lambda: watch[f'clipped {axis}'] == str(count))  # noqa: B023
    assert watch.status.level == DiagnosticStatus.OK  # a learner explores beyond the bounds, too


def test_diagnostics_hold_name_status_agent_and_counters(
        processes: Processes, make_client: MakeClient) -> None:
    processes.start(
        'ros2', 'run', 'rocket_sim_node', 'simulator', '--ros-args', '-r', '__ns:=/sim_0',
        '-p', f'num_envs:={N}')
    client = make_client(namespace='/sim_0', resend_after=5.0)
    client.reset(1)
    client.step(FULL)
    watch = Watch(client)
    watch.until(lambda: watch['step'] == '1')
    assert watch.status.name == 'sim_0/simulator: wire'
    assert watch.status.hardware_id == 'sim_0/simulator'
    assert watch.status.level == DiagnosticStatus.OK
    assert watch.status.message == 'ok'
    said = {item.key: item.value for item in watch.status.values}
    assert said.items() >= {
        'world': 'rocket', 'num_envs': str(N), 'mode': 'lockstep', 'last refusal': '',
        'agent': str(client.connection.agent), 'session': str(client.session),
        'refused on action': '0', 'refused on reset': '0', 'refused on restore': '0',
        'refused on snapshot': '0', 'refused on release': '0', 'repeated answers': '0'}.items()


def test_a_refusal_is_reported_at_once_and_by_name(
        processes: Processes, make_client: MakeClient) -> None:
    """It is reported before the response. Then the level falls back, and the text stays."""
    processes.fork_node('rocket_sim_node', 'simulator', num_envs=N, agent_lease=600.0)
    client = make_client()
    client.reset(1)
    watch = Watch(client)
    watch.until(lambda: watch['last refusal'] == '' != watch['agent'])
    for name, kind in (('reset', srv.Reset), ('release', srv.Release)):
        answer = call(client, kind, f'simulator/{name}', agent=STRANGER)
        answered = time.time()
        watch.until(lambda: watch[f'refused on {name}'] == '1')  # noqa: B023
        first = next(r for r in watch.reports if values_of(r)[f'refused on {name}'] == '1')
        assert first.status[0].level == DiagnosticStatus.WARN
        assert first.status[0].message == f'{name}: {answer.message}'
        assert moment(first) <= answered
        watch.until(lambda: watch.status.level == DiagnosticStatus.OK)
        refusal = f'{name}: {answer.message}'
        assert watch['last refusal'] == values_of(first)['last refusal'] == refusal


def test_the_wire_measures_time_by_the_steady_clock() -> None:
    """Time is measured by `time.monotonic`; each timer has the steady clock.

    There are two exceptions: the times and ages of files, and the module that detects steps of
    the system clock.
    """
    for path in sorted(Path(wire.__path__[0]).rglob('*.py')):
        clocks = {'time.monotonic', 'time.sleep', 'time.perf_counter'}
        if path.name == 'clock_steps.py':
            clocks.add('time.time')
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
                continue
            name = ast.unparse(node.func)
            assert not name.startswith('datetime.'), path
            assert not name.startswith('time.') or name in clocks, (path, name)
            given = {keyword.arg for keyword in node.keywords}
            if name.endswith('.create_timer'):
                assert 'clock' in given, (path, node.lineno)
            if 'throttle_duration_sec' in given:
                assert 'throttle_time_source_type' in given, (path, node.lineno)
