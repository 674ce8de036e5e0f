# SPDX-License-Identifier: Apache-2.0
"""The services of simulation_interfaces, of a simulator in lock-step and one in real time."""
from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from action_msgs.msg import GoalStatus
from ament_index_python.packages import get_package_share_directory
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.node import Node
from rclpy.time import Time
from rocket_msgs.msg import RocketState
from simulation_interfaces import srv
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import Bounds
from simulation_interfaces.msg import EntityCategory
from simulation_interfaces.msg import EntityFilters
from simulation_interfaces.msg import Result
from simulation_interfaces.msg import SimulationState as State
from simulation_interfaces.msg import SimulatorFeatures as Features
from support.processes import Processes
from support.processes import wait_until

from rocket_sim_node import worlds
from rocket_sim_node.standard_views import entities
from rocket_sim_node.telemetry.samples import FIELDS
from rocket_sim_node.telemetry.samples import samples_of
from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.client.connection import ConnectionOptions
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.node.polling import PolledEntity
from rocket_sim_node.wire.node.running import make_executor
from rocket_sim_node.worlds import EnvironmentRestarted
from rocket_sim_node.worlds.actions import idle_action

N, SEED = 3, 7
STEPS = 40
DT = round(worlds.make('rocket').spec.dt * 1e9)
"""ns"""
FAILED = Result.RESULT_OPERATION_FAILED
SERVICES = {
    Features.SIMULATION_RESET: 'ResetSimulation',
    Features.SIMULATION_RESET_TIME: 'ResetSimulation',
    Features.SIMULATION_RESET_STATE: 'ResetSimulation',
    Features.SIMULATION_STATE_GETTING: 'GetSimulationState',
    Features.SIMULATION_STATE_SETTING: 'SetSimulationState',
    Features.SIMULATION_STATE_PAUSE: 'SetSimulationState',
    Features.STEP_SIMULATION_SINGLE: 'StepSimulation',
    Features.STEP_SIMULATION_MULTIPLE: 'StepSimulation',
    Features.ENTITY_STATE_GETTING: 'GetEntityState',
    Features.WORLD_INFO_GETTING: 'GetCurrentWorld',
    Features.AVAILABLE_WORLDS: 'GetAvailableWorlds'}
"""Which service a feature stands for, as the comments of SimulatorFeatures.msg say."""
UNSUPPORTED = (
    'DeleteEntity', 'GetEntityBounds', 'GetEntityInfo', 'GetNamedPoseBounds', 'GetNamedPoses',
    'GetSpawnables', 'LoadWorld', 'SetEntityInfo', 'SetEntityState', 'SpawnEntities',
    'SpawnEntity', 'UnloadWorld')
HASHES = {
    'srv/StepSimulation':
        'RIHS01_913fe0653690ce6bf8f09f316e6a626747012e9fca31e26719910d417aa8565c',
    'srv/GetEntitiesStates':
        'RIHS01_0a76170d0c1c90e1eaf805cfab78ea801d1f82df309a28c1f0fae4b570f19754',
    'srv/SpawnEntities':
        'RIHS01_41703a359ee032bf4fc230f144f531705ba039a2e97edeae1f7997dd83b04857',
    'action/SimulateSteps':
        'RIHS01_f0837c898e1219cd73bf4c041feab41e8c533e8e1057e982744dba7b093467eb'}
"""Type hashes: they change with any field of the definitions that are vendored."""


class Caller:
    """Calls the services of simulators in two namespaces."""

    def __init__(self, domain: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node('caller', context=self.context)
        self.executor = make_executor(self.context)
        self.executor.add_node(self.node)
        self._clients: dict[str, Any] = {}

    def __call__(self, namespace: str, name: str, /, **fields: Any) -> Any:
        """Return the answer of the service of a type."""
        snake = ''.join(f'_{c.lower()}' if c.isupper() else c for c in name)[1:]
        service = f'{namespace}/simulator/{snake}'
        kind = getattr(srv, name)
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, service)
        client = self._clients[service]
        assert client.wait_for_service(30.0), service
        future = client.call_async(kind.Request(**fields))
        self.wait_until(future.done)
        return future.result()

    def good(self, namespace: str, name: str, /, **fields: Any) -> Any:
        """Return an answer that must be OK."""
        answer = self(namespace, name, **fields)
        assert answer.result.result == Result.RESULT_OK, answer.result
        return answer

    def refused(self, code: int, *words: str, call: tuple[str, str], **fields: Any) -> None:
        """Call what must be refused, with words in the reason."""
        result = self(*call, **fields).result
        assert result.result == code, result
        assert all(word in result.error_message for word in words), result.error_message

    def wait_until(self, done: Callable[[], bool]) -> None:
        """Serve the node until it is done."""
        def look() -> bool:
            end = time.monotonic() + 0.1
            while not done() and time.monotonic() < end:
                self.executor.spin_once(timeout_sec=0.05)
            return done()
        wait_until(look, 30.0)

    def set_state(self, namespace: str, state: int) -> Any:
        """Return the result of SetSimulationState."""
        return self(namespace, 'SetSimulationState', state=State(state=state)).result

    def state(self, namespace: str) -> int:
        """Return the state of the simulation."""
        return int(self.good(namespace, 'GetSimulationState').state.state)

    def motion(self, namespace: str, **fields: Any) -> tuple[int, np.ndarray]:
        """Return the stamp, ns, and position, orientation and velocities `(K, 13)`."""
        states = self.good(namespace, 'GetEntitiesStates', **fields).states
        assert {state.header.frame_id for state in states} <= {'world'}
        stamps = {10**9 * s.header.stamp.sec + s.header.stamp.nanosec for s in states}
        assert len(stamps) == 1
        return stamps.pop(), np.array([numbers(state) for state in states])


def numbers(state: Any) -> list[float]:
    return [getattr(value, axis) for value, axes in (
        (state.pose.position, 'xyz'), (state.pose.orientation, 'xyzw'),
        (state.twist.linear, 'xyz'), (state.twist.angular, 'xyz')) for axis in axes]


def motion_of(world: Any) -> np.ndarray:
    return np.concatenate(entities.states_of(world.telemetry(slice(None))), axis=1)


def fall(world: Any, steps: int) -> np.ndarray:
    for _ in range(steps):
        world.step(idle_action(world.spec))
    return motion_of(world)


@pytest.fixture(scope='module')
def group(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Processes]:
    """Both simulators."""
    group = Processes(tmp_path_factory.mktemp('simulators'))
    for namespace, parameters in (
            ('/lock', {'agent_lease': 1.0}),
            ('/real', {'mode': 'realtime', 'realtime_factor': 10.0})):
        group.fork_node(
            'rocket_sim_node', 'simulator', (f'__ns:={namespace}',), num_envs=N, seed=SEED,
            **parameters)
    yield group
    group.end()


@pytest.fixture(scope='module')
def shared(group: Processes) -> Iterator[Caller]:
    """A caller in their domain."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        caller = Caller(group.domain)
    yield caller
    rclpy.shutdown(context=caller.context)


@pytest.fixture
def call(shared: Caller) -> Caller:
    """A caller of simulators that are paused at the start."""
    for namespace in ('/lock', '/real'):
        shared.set_state(namespace, State.STATE_PAUSED)
        shared.good(namespace, 'ResetSimulation')
    return shared


@pytest.fixture
def pilot(shared: Caller) -> Iterator[Client]:
    """An agent for the simulator in lock-step."""
    node = Node('pilot', context=shared.context, namespace='/lock')
    executor = make_executor(shared.context)
    executor.add_node(node)
    client = Client(node, executor, ConnectionOptions(resend_after=0.1, patience=15.0))
    yield client
    client.close()
    PolledEntity.destroy_all(node)
    node.destroy_node()


def test_features_agree_with_the_services(call: Caller) -> None:
    known = call.node.get_service_names_and_types_by_node('simulator', '/lock')
    offered = {
        kinds[0].rpartition('/')[2] for name, kinds in known
        if kinds[0].startswith('simulation_interfaces/') and '/_action/' not in name}
    features = call('/lock', 'GetSimulatorFeatures').features.features.tolist()
    stand_for = {SERVICES[feature] for feature in features if feature in SERVICES}
    assert set(features) == SERVICES.keys() | {Features.STEP_SIMULATION_ACTION}
    assert any(name.endswith('/simulate_steps/_action/send_goal') for name, _ in known)
    supported = stand_for | {'GetSimulatorFeatures', 'GetEntities', 'GetEntitiesStates'}
    assert offered - set(UNSUPPORTED) == supported
    assert offered == {
        name for name in dir(srv) if name[0].isupper() and '_' not in name}


@pytest.mark.parametrize('name', UNSUPPORTED)
def test_other_services_of_the_standard_are_refused_by_its_code(
        call: Caller, name: str) -> None:
    found = call.motion('/lock')
    call.refused(Result.RESULT_FEATURE_UNSUPPORTED, 'not supported', call=('/lock', name))
    np.testing.assert_array_equal(call.motion('/lock')[1], found[1])


def test_definitions_are_those_of_the_standard() -> None:
    share = Path(get_package_share_directory('simulation_interfaces'))
    for name, expected in HASHES.items():
        described = json.loads((share / f'{name}.json').read_text())
        hashes = {one['type_name']: one['hash_string'] for one in described['type_hashes']}
        assert hashes[f'simulation_interfaces/{name}'] == expected


def test_steps_are_those_in_process_to_the_bit(call: Caller) -> None:
    world = worlds.make('rocket', N, seed=SEED)
    for namespace in ('/lock', '/real'):
        world.reset(SEED)
        assert call.motion(namespace)[0] == 0
        np.testing.assert_array_equal(call.motion(namespace)[1], motion_of(world))
        call.good(namespace, 'StepSimulation')  # one, by default
        call.good(namespace, 'StepSimulation', steps=STEPS)
        call.good(namespace, 'StepSimulation', steps=0)
        stamp, found = call.motion(namespace)
        assert stamp == (STEPS + 1) * DT
        np.testing.assert_array_equal(found, fall(world, STEPS + 1))
        one = call.good(namespace, 'GetEntityState', entity='rocket_2').state
        assert numbers(one) == found[2].tolist()
        assert np.isnan(one.acceleration.linear.x)


def test_entities_have_the_numbers_of_topic_state(call: Caller) -> None:
    heard: list[Any] = []
    subscription = call.node.create_subscription(
        RocketState, '/lock/state', heard.append, qos.EVENTS)
    call.wait_until(lambda: call.node.count_publishers('/lock/state') > 0)
    # The simulator may not know the subscription yet.
    call.wait_until(lambda: bool(call.good('/lock', 'ResetSimulation') and call.good(
        '/lock', 'StepSimulation', steps=3) and heard))
    heard.clear()
    call.good('/lock', 'ResetSimulation')
    call.good('/lock', 'StepSimulation', steps=STEPS)
    stamp, found = call.motion('/lock')
    call.wait_until(lambda: any(STEPS in message.step for message in heard))
    header = heard[-1].header
    assert header.frame_id == 'world'
    assert Time.from_msg(header.stamp).nanoseconds == STEPS * DT == stamp
    samples = samples_of(heard[-1])
    columns = [FIELDS[name] for name in (
        'position', 'orientation', 'linear_velocity', 'angular_velocity')]
    last = samples.take(samples.step == STEPS)
    np.testing.assert_array_equal(
        np.concatenate([last.values[:, column] for column in columns], axis=1), found)
    call.node.destroy_subscription(subscription)


def test_scopes_of_a_reset(call: Caller) -> None:
    world = worlds.make('rocket', N, seed=SEED)
    call.good('/lock', 'StepSimulation', steps=STEPS)
    flown = fall(world, STEPS)
    call.good('/lock', 'ResetSimulation', scope=1)
    stamp, found = call.motion('/lock')
    assert stamp == 0
    np.testing.assert_array_equal(found, flown)
    call.good('/lock', 'StepSimulation', steps=STEPS)
    call.good('/lock', 'ResetSimulation', scope=2)
    assert call.motion('/lock')[0] == (STEPS + 1) * DT  # the time goes on
    world.reset()
    np.testing.assert_array_equal(call.motion('/lock')[1], motion_of(world))
    call.good('/lock', 'ResetSimulation', scope=255)
    world.reset(SEED)
    np.testing.assert_array_equal(call.motion('/lock')[1], motion_of(world))
    for scope in (4, 6, 8, 254):
        call.refused(
            Result.RESULT_FEATURE_UNSUPPORTED, f'scope: got {scope}',
            call=('/lock', 'ResetSimulation'), scope=scope)


def test_play_and_pause_in_real_time(call: Caller) -> None:
    assert call.state('/real') == State.STATE_PAUSED
    assert call.set_state('/real', State.STATE_PLAYING).result == Result.RESULT_OK
    assert call.state('/real') == State.STATE_PLAYING
    call.wait_until(lambda: call.motion('/real')[0] >= 400_000_000)
    call.refused(FAILED, 'playing', call=('/real', 'StepSimulation'), steps=1)
    call.good('/real', 'ResetSimulation')
    assert call.state('/real') == State.STATE_PLAYING  # a reset plays on
    call.wait_until(lambda: call.motion('/real')[0] > 0)
    assert call.set_state('/real', State.STATE_PAUSED).result == Result.RESULT_OK
    stamp, found = call.motion('/real')
    np.testing.assert_array_equal(
        found, fall(worlds.make('rocket', N, seed=SEED), stamp // DT))
    call.good('/real', 'StepSimulation', steps=2)
    assert call.motion('/real')[0] == stamp + 2 * DT  # no tick came between


def test_states_follow_the_standard(call: Caller) -> None:
    already = srv.SetSimulationState.Response.ALREADY_IN_TARGET_STATE
    assert call.set_state('/lock', State.STATE_PAUSED).result == already
    playing = call.set_state('/lock', State.STATE_PLAYING)
    assert playing.result == srv.SetSimulationState.Response.STATE_TRANSITION_ERROR
    assert 'mode:=realtime' in playing.error_message
    call.good('/lock', 'StepSimulation', steps=STEPS)
    assert call.set_state('/lock', State.STATE_STOPPED).result == Result.RESULT_OK
    assert call.state('/lock') == State.STATE_STOPPED
    assert call.motion('/lock')[0] == 0
    call.refused(FAILED, 'stopped', call=('/lock', 'StepSimulation'), steps=1)
    assert call.set_state('/lock', State.STATE_STOPPED).result == already
    call.good('/lock', 'ResetSimulation')
    assert call.state('/lock') == State.STATE_STOPPED
    assert call.set_state('/lock', State.STATE_PAUSED).result == Result.RESULT_OK
    for state in (State.STATE_QUITTING, 99):
        result = call.set_state('/lock', state)
        assert result.result == Result.RESULT_FEATURE_UNSUPPORTED
        assert f'state: got {state}' in result.error_message
    call.refused(FAILED, 'at most 100000', call=('/lock', 'StepSimulation'), steps=2**64 - 1)


def test_filters(call: Caller) -> None:
    def names(**filters: Any) -> list[str]:
        return list(call.good(
            '/lock', 'GetEntities', filters=EntityFilters(**filters)).entities)

    assert names() == ['rocket_0', 'rocket_1', 'rocket_2']
    assert names(filter='rocket_[12]') == ['rocket_1', 'rocket_2']
    position = call.motion('/lock')[1][1, :3]
    sphere = Bounds(type=Bounds.TYPE_SPHERE)
    sphere.points = [vector(*position), vector(1e-6)]
    assert names(bounds=sphere) == ['rocket_1']
    assert names(bounds=sphere, filter='rocket_[02]') == []
    for filters, code, word in (
            (EntityFilters(filter='('), FAILED, 'filter: got'),
            (EntityFilters(categories=[EntityCategory()]), Result.RESULT_FEATURE_UNSUPPORTED,
             'categories'),
            (EntityFilters(bounds=Bounds(type=Bounds.TYPE_BOX)), Result.RESULT_FEATURE_UNSUPPORTED,
             'bounds'),
            (EntityFilters(bounds=Bounds(type=Bounds.TYPE_SPHERE)), FAILED, '0 points')):
        for name in ('GetEntities', 'GetEntitiesStates'):
            call.refused(code, word, call=('/lock', name), filters=filters)
    call.refused(
        Result.RESULT_NOT_FOUND, 'rocket_0 to rocket_2', call=('/lock', 'GetEntityState'),
        entity='rocket_3')


def vector(x: float, y: float = 0.0, z: float = 0.0) -> Any:
    from geometry_msgs.msg import Vector3
    return Vector3(x=float(x), y=float(y), z=float(z))


def test_worlds(call: Caller) -> None:
    current = call.good('/real', 'GetCurrentWorld').world
    assert current.name == 'rocket'
    assert 'real time' in current.description
    known = call.good('/lock', 'GetAvailableWorlds').worlds
    assert [world.name for world in known] == list(worlds.names())
    assert current.world_resource.uri in {world.world_resource.uri for world in known}
    call.refused(
        Result.RESULT_FEATURE_UNSUPPORTED, 'additional_sources',
        call=('/lock', 'GetAvailableWorlds'), additional_sources=['https://example.org'])


def test_an_agent_has_precedence_and_is_named(call: Caller, pilot: Client) -> None:
    world = worlds.make('rocket', N, seed=SEED)
    idle = idle_action(world.spec)
    pilot.reset(SEED)
    assert call.state('/lock') == State.STATE_PLAYING
    for name, fields in (
            ('StepSimulation', {'steps': 1}), ('ResetSimulation', {}),
            ('SetSimulationState', {'state': State(state=State.STATE_STOPPED)})):
        pilot.step(idle)
        call.refused(
            FAILED, f'agent {pilot.connection.agent}, node /lock/pilot, controls this simulator',
            call=('/lock', name), **fields)
    np.testing.assert_array_equal(call.motion('/lock')[1], fall(world, 3))  # nothing has changed
    pilot.close()
    assert call.state('/lock') == State.STATE_PAUSED
    call.good('/lock', 'StepSimulation')
    np.testing.assert_array_equal(call.motion('/lock')[1], fall(world, 1))


def test_an_agent_silent_beyond_its_lease_gets_a_restart_error(
        call: Caller, pilot: Client) -> None:
    pilot.reset(SEED)
    call.wait_until(lambda: call('/lock', 'StepSimulation').result.result == Result.RESULT_OK)
    assert call.motion('/lock')[0] > 0
    with pytest.raises(EnvironmentRestarted):
        pilot.step(idle_action(pilot.spec))


def test_the_action_steps_and_can_be_cancelled(call: Caller) -> None:
    action = ActionClient(call.node, SimulateSteps, '/lock/simulator/simulate_steps')
    call.wait_until(action.server_is_ready)
    heard: list[tuple[int, int]] = []

    def send(steps: int) -> Any:
        sent = action.send_goal_async(SimulateSteps.Goal(steps=steps), lambda message: (
            heard.append((message.feedback.completed_steps, message.feedback.remaining_steps))))
        call.wait_until(sent.done)
        return sent.result()

    def ended(goal: Any) -> tuple[int, int, str]:
        asked = goal.get_result_async()
        call.wait_until(asked.done)
        result = asked.result().result.result
        return asked.result().status, result.result, result.error_message

    assert ended(send(STEPS)) == (GoalStatus.STATUS_SUCCEEDED, Result.RESULT_OK, '')
    world = worlds.make('rocket', N, seed=SEED)
    np.testing.assert_array_equal(call.motion('/lock')[1], fall(world, STEPS))
    call.wait_until(lambda: heard[-1:] == [(STEPS, 0)])
    assert all(done + left == STEPS for done, left in heard)

    goal = send(2**63)
    call.refused(FAILED, 'simulate_steps', call=('/lock', 'StepSimulation'))
    status, code, why = ended(send(1))
    assert (status, code) == (GoalStatus.STATUS_ABORTED, FAILED)
    assert 'simulate_steps' in why
    cancelled = goal.cancel_goal_async()
    call.wait_until(cancelled.done)
    status, code, why = ended(goal)
    assert (status, code) == (GoalStatus.STATUS_CANCELED, FAILED)
    assert why.startswith('cancelled; ')
    assert call.motion('/lock')[0] == (STEPS + int(why.split()[1])) * DT


def test_an_agent_that_takes_control_aborts_the_action(call: Caller, pilot: Client) -> None:
    action = ActionClient(call.node, SimulateSteps, '/lock/simulator/simulate_steps')
    call.wait_until(action.server_is_ready)
    sent = action.send_goal_async(SimulateSteps.Goal(steps=2**63))
    call.wait_until(sent.done)
    pilot.reset(SEED)
    asked = sent.result().get_result_async()
    call.wait_until(asked.done)
    assert asked.result().status == GoalStatus.STATUS_ABORTED
    assert f'agent {pilot.connection.agent}' in asked.result().result.result.error_message


@pytest.mark.parametrize('late', [False, True])
def test_a_simulator_that_stops_aborts_the_action(
        call: Caller, group: Processes, late: bool) -> None:
    simulator = group.run_node('rocket_sim_node', 'simulator', ('__ns:=/stopped',), num_envs=1)
    action = ActionClient(call.node, SimulateSteps, '/stopped/simulator/simulate_steps')
    call.wait_until(action.server_is_ready)
    flown: list[int] = []
    sent = action.send_goal_async(SimulateSteps.Goal(steps=2**63), lambda message: (
        flown.append(message.feedback.completed_steps)))
    call.wait_until(sent.done)
    goal = sent.result()
    call.wait_until(lambda: flown)
    if late:  # the goal ends before its result is asked for
        simulator.signal(signal.SIGINT)
        call.wait_until(lambda: goal.status == GoalStatus.STATUS_ABORTED)
        asked = goal.get_result_async()
    else:
        asked = goal.get_result_async()
        call('/stopped', 'GetSimulationState')  # the simulator has received the request before
        simulator.signal(signal.SIGINT)
    call.wait_until(asked.done)
    assert asked.result().status == GoalStatus.STATUS_ABORTED
    result = asked.result().result.result
    assert result.result == FAILED
    assert result.error_message.startswith('the simulator is stopping; ')
    assert simulator.wait(10.0) == 0
    action.destroy()


def test_the_ros2_command_calls_the_services(call: Caller, group: Processes) -> None:
    command = group.start(
        'ros2', 'service', 'call', '/lock/simulator/step_simulation',
        'simulation_interfaces/srv/StepSimulation', '{steps: 5}')
    assert command.wait(30.0) == 0
    assert 'result=1' in command.output()
    assert call.motion('/lock')[0] == 5 * DT


def test_a_simulator_starts_without_the_package(processes: Processes) -> None:
    without = processes.start('python', '-c', """
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] == 'simulation_interfaces':
            raise ModuleNotFoundError(f'No module named {name!r}', name=name)
sys.meta_path.insert(0, Absent())
sys.argv = ['simulator', '--ros-args', '-p', 'num_envs:=1']
from rocket_sim_node.nodes.simulator import main
main()
""")
    without.wait_for('waiting for an agent', 30.0)
    assert without.output().count('simulation_interfaces are not offered') == 1
