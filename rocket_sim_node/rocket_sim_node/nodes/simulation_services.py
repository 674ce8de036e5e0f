# SPDX-License-Identifier: Apache-2.0
"""Services of simulation_interfaces, the standard of simulators, below the simulator's name.

Calls that move the world are refused while an agent has control, with the name of the agent. All
services of the standard are there: a caller would wait in vain for one that is absent.
"""
from __future__ import annotations

import re
from collections.abc import Callable
from collections.abc import Sequence
from functools import partial
from typing import Any
from typing import TypeAlias

import numpy as np
from geometry_msgs.msg import Point
from geometry_msgs.msg import Quaternion
from geometry_msgs.msg import Vector3
from rclpy.executors import Executor
from rclpy.node import Node
from simulation_interfaces import srv
from simulation_interfaces.msg import Bounds
from simulation_interfaces.msg import EntityState
from simulation_interfaces.msg import Result
from simulation_interfaces.msg import SimulationState as State
from simulation_interfaces.msg import SimulatorFeatures as Features
from simulation_interfaces.msg import WorldResource
from simulation_interfaces.srv import GetAvailableWorlds
from simulation_interfaces.srv import GetCurrentWorld
from simulation_interfaces.srv import GetEntities
from simulation_interfaces.srv import GetEntitiesStates
from simulation_interfaces.srv import GetEntityState
from simulation_interfaces.srv import GetSimulationState
from simulation_interfaces.srv import GetSimulatorFeatures
from simulation_interfaces.srv import ResetSimulation
from simulation_interfaces.srv import SetSimulationState
from simulation_interfaces.srv import StepSimulation

from rocket_sim_node import frames
from rocket_sim_node import worlds
from rocket_sim_node.nodes.simulate_steps import SimulateStepsServer
from rocket_sim_node.standard_views import entities
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.wire.node.diagnostics import shortened
from rocket_sim_node.wire.server.server import Server
from rocket_sim_node.worlds.base import SimulatedWorld

Handler: TypeAlias = Callable[[Any, Any], None]

MOST_STEPS = 100_000
"""Maximum number of steps of a call: nothing else is served meanwhile."""
_STATES = {
    State.STATE_STOPPED: 'stopped', State.STATE_PLAYING: 'playing', State.STATE_PAUSED: 'paused'}
UNSUPPORTED = (
    'DeleteEntity', 'GetEntityBounds', 'GetEntityInfo', 'GetNamedPoseBounds', 'GetNamedPoses',
    'GetSpawnables', 'LoadWorld', 'SetEntityInfo', 'SetEntityState', 'SpawnEntities',
    'SpawnEntity', 'UnloadWorld')
"""Services of the standard that would change or describe more than one world of equal rockets."""


class Refused(Exception):
    """A call is refused: a code of the standard, and the reason."""

    def __init__(self, code: int, why: str) -> None:
        """Keep both."""
        super().__init__(why)
        self.code = code


class SimulationServices:
    """Offers a server's world by the standard's services."""

    def __init__(self, node: Node, server: Server, world: SimulatedWorld, seed: int) -> None:
        """Create the services.

        :param world: of the server.
        :param seed: of the world at start; a reset of all begins with it again.
        """
        self._server, self._stepper = server, server.idle_stepper
        self._world, self._seed = world, seed
        self._spec = self._world.spec
        self._stopped = 0
        """Session in which the simulation was stopped last."""
        offered: tuple[tuple[type, str, Handler, tuple[int, ...]], ...] = (
            (GetSimulatorFeatures, 'get_simulator_features', self._features, ()),
            (ResetSimulation, 'reset_simulation', self._reset, (
                Features.SIMULATION_RESET, Features.SIMULATION_RESET_TIME,
                Features.SIMULATION_RESET_STATE)),
            (GetSimulationState, 'get_simulation_state', self._get_state, (
                Features.SIMULATION_STATE_GETTING,)),
            (SetSimulationState, 'set_simulation_state', self._set_state, (
                Features.SIMULATION_STATE_SETTING, Features.SIMULATION_STATE_PAUSE)),
            (StepSimulation, 'step_simulation', self._step, (
                Features.STEP_SIMULATION_SINGLE, Features.STEP_SIMULATION_MULTIPLE)),
            (GetEntities, 'get_entities', self._entities, ()),
            (GetEntityState, 'get_entity_state', self._entity_state, (
                Features.ENTITY_STATE_GETTING,)),
            (GetEntitiesStates, 'get_entities_states', self._entities_states, ()),
            (GetCurrentWorld, 'get_current_world', self._current_world, (
                Features.WORLD_INFO_GETTING,)),
            (GetAvailableWorlds, 'get_available_worlds', self._available_worlds, (
                Features.AVAILABLE_WORLDS,)))
        self._steps = SimulateStepsServer(node, server, self._cannot_step)
        self._supported = sorted((
            Features.STEP_SIMULATION_ACTION,
            *(feature for *_, given in offered for feature in given)))
        server.attend([
            node.create_service(kind, f'~/{name}', partial(_answer, handler))
            for kind, name, handler, _ in offered])
        for name in UNSUPPORTED:
            # Older versions of the package lack some of them.
            if (kind := getattr(srv, name, None)) is not None:
                node.create_service(
                    kind, f'~/{service_name(name)}', partial(_answer, partial(_refuse, name)))

    def destroy(self, executor: Executor) -> None:
        """Remove the action; the services go with the node.

        :param executor: the node's.
        """
        self._steps.destroy(executor)

    def _features(self, request: Any, response: Any) -> None:
        response.features.features = self._supported
        response.features.custom_info = (
            'Hoverslam; see docs/how-to/simulation-interfaces.md of the project')

    # Calls that move the world

    def _check_control(self) -> None:
        """Refuse to move the world while an agent has control, or the action steps."""
        why = self._stepper.flown_by() or (
            'action simulate_steps is being executed' if self._steps.active else '')
        if why:
            raise Refused(Result.RESULT_OPERATION_FAILED, why)

    def _check_paused(self) -> None:
        """Refuse to step unless the simulation is paused."""
        self._check_control()
        if (state := self._state) != State.STATE_PAUSED:
            raise Refused(
                Result.RESULT_OPERATION_FAILED,
                f'the simulation is {_STATES[state]}; pause it first (SetSimulationState, 2)')

    def _cannot_step(self) -> tuple[int, str]:
        try:
            self._check_paused()
        except Refused as refused:
            return refused.code, str(refused)
        return Result.RESULT_OK, ''

    @property
    def _state(self) -> int:
        if self._stepper.flown_by() or self._stepper.playing:
            return int(State.STATE_PLAYING)
        stopped = self._stopped == self._server.present[0]
        return int(State.STATE_STOPPED if stopped else State.STATE_PAUSED)

    def _get_state(self, request: Any, response: Any) -> None:
        response.state.state = self._state

    def _set_state(self, request: Any, response: Any) -> None:
        self._check_control()
        wanted, state = request.state.state, self._state
        if wanted not in _STATES:
            raise Refused(Result.RESULT_FEATURE_UNSUPPORTED, (
                f'state: got {wanted}, expected '
                f'{", ".join(f"{number} ({name})" for number, name in _STATES.items())}'))
        if wanted == state:
            raise Refused(
                response.ALREADY_IN_TARGET_STATE, f'state: is {_STATES[wanted]} already')
        try:
            self._stepper.play(wanted == State.STATE_PLAYING)
        except ValueError as error:
            raise Refused(response.STATE_TRANSITION_ERROR, f'state: {error}') from None
        self._stopped = 0
        if wanted == State.STATE_STOPPED:
            self._stepper.begin(self._world.reset(self._seed), restart_time=True)
            self._stopped = self._server.present[0]

    def _reset(self, request: Any, response: Any) -> None:
        self._check_control()
        scope = request.scope
        everything = scope in (request.SCOPE_DEFAULT, request.SCOPE_ALL)
        if not everything and scope & ~(request.SCOPE_TIME | request.SCOPE_STATE):
            raise Refused(Result.RESULT_FEATURE_UNSUPPORTED, (
                f'scope: got {scope}, expected 1 (time), 2 (state), their sum 3, or 0 or 255 '
                '(all)'))
        stopped = self._state == State.STATE_STOPPED
        if everything:
            observation = self._world.reset(self._seed)
        elif scope & request.SCOPE_STATE:
            observation = self._world.reset()
        else:
            observation = self._world.observe()
        self._stepper.begin(
            observation, restart_time=everything or bool(scope & request.SCOPE_TIME))
        if stopped:
            self._stopped = self._server.present[0]

    def _step(self, request: Any, response: Any) -> None:
        self._check_paused()
        steps = request.steps
        if steps > MOST_STEPS:
            raise Refused(Result.RESULT_OPERATION_FAILED, (
                f'steps: got {steps}, expected at most {MOST_STEPS}; action simulate_steps has no '
                'limit'))
        flown = self._stepper.step(steps)
        if flown < steps:
            raise Refused(
                Result.RESULT_OPERATION_FAILED,
                f'the simulator is stopping; {flown} of {steps} steps were flown')

    # Entities

    def _rows(self, filters: Any) -> list[int]:
        """Return the rows of the rockets that pass all filters."""
        for name, given in (('categories', filters.categories), ('tags', filters.tags.tags)):
            if given:
                raise Refused(
                    Result.RESULT_FEATURE_UNSUPPORTED, f'filters: {name}: rockets have none')
        try:
            rows = entities.rows_named(filters.filter, self._spec.num_envs)
        except ValueError as error:
            raise Refused(
                Result.RESULT_OPERATION_FAILED, f'filters: {shortened(str(error))}') from None
        bounds = filters.bounds
        if bounds.type == Bounds.TYPE_EMPTY:
            return rows
        if bounds.type != Bounds.TYPE_SPHERE:
            raise Refused(Result.RESULT_FEATURE_UNSUPPORTED, (
                f'filters: bounds: type: got {bounds.type}, expected {Bounds.TYPE_EMPTY} '
                f'(none) or {Bounds.TYPE_SPHERE} (sphere)'))
        if len(bounds.points) != 2:
            raise Refused(Result.RESULT_OPERATION_FAILED, (
                f'filters: bounds: {len(bounds.points)} points, expected 2: the centre, and the '
                'radius as x'))
        centre, radius = bounds.points
        inside = entities.within(
            self._motion(rows)[0], (centre.x, centre.y, centre.z), radius.x)
        return [row for row, one in zip(rows, inside, strict=True) if one]

    def _motion(self, rows: Sequence[int]) -> tuple[entities.F64, ...]:
        return entities.states_of(self._world.telemetry(np.asarray(rows, np.int64)))

    def _states(self, rows: Sequence[int]) -> list[Any]:
        """Return the states of rockets as messages, with the stamp that `state` has now."""
        header = conversion.header(self._server.time, frames.WORLD)
        states = []
        for position, orientation, linear, angular in zip(
                *(values.tolist() for values in self._motion(rows)), strict=True):
            state = EntityState(header=header)
            state.pose.position = _filled(Point(), position)
            state.pose.orientation = _filled(Quaternion(), orientation)
            state.twist.linear = _filled(Vector3(), linear)
            state.twist.angular = _filled(Vector3(), angular)
            for unknown in (state.acceleration.linear, state.acceleration.angular):
                _filled(unknown, [float('nan')] * 3)
            states.append(state)
        return states

    def _entities(self, request: Any, response: Any) -> None:
        response.entities = [entities.name_of(row) for row in self._rows(request.filters)]

    def _entity_state(self, request: Any, response: Any) -> None:
        row = entities.row_of(request.entity, self._spec.num_envs)
        if row is None:
            raise Refused(Result.RESULT_NOT_FOUND, (
                f'entity: got {shortened(request.entity)!r}, expected '
                f'{entities.name_of(0)} to {entities.name_of(self._spec.num_envs - 1)}'))
        response.state, = self._states([row])

    def _entities_states(self, request: Any, response: Any) -> None:
        rows = self._rows(request.filters)
        response.entities = [entities.name_of(row) for row in rows]
        response.states = self._states(rows)

    # Worlds

    def _current_world(self, request: Any, response: Any) -> None:
        mode = 'real time' if self._stepper.has_clock else 'lock-step'
        response.world = _world(self._spec.name, (
            f'{self._spec.num_envs} rockets, {self._spec.dt:g} s a step, {mode}'))

    def _available_worlds(self, request: Any, response: Any) -> None:
        for name, given in (('additional_sources', request.additional_sources),
                            ('filter: tags', request.filter.tags)):
            if given:
                raise Refused(
                    Result.RESULT_FEATURE_UNSUPPORTED, f'{name}: got {len(given)}, expected none')
        response.worlds = [
            _world(name, f'started by parameter world:={name} of the simulator')
            for name in worlds.names()]


def _answer(handler: Handler, request: Any, response: Any) -> Any:
    """Answer a call; GetSimulatorFeatures alone has no result."""
    code, why = Result.RESULT_OK, ''
    try:
        handler(request, response)
    except Refused as refused:
        code, why = refused.code, str(refused)
    if hasattr(response, 'result'):
        response.result.result, response.result.error_message = code, why
    return response


def _refuse(name: str, request: Any, response: Any) -> None:
    """Answer a service that is not supported."""
    raise Refused(Result.RESULT_FEATURE_UNSUPPORTED, (
        f'{service_name(name)} is not supported: a simulator has one world of identical rockets, '
        'which its parameters choose; GetSimulatorFeatures lists what is supported'))


def service_name(name: str) -> str:
    """Return the name of the service of a type, such as spawn_entity of SpawnEntity."""
    return re.sub(r'(?<=[a-z])(?=[A-Z])', '_', name).lower()


def _world(name: str, description: str) -> Any:
    world = WorldResource(name=name, description=description)
    world.world_resource.uri = f'hoverslam:{name}'
    return world


def _filled(message: Any, values: Sequence[float]) -> Any:
    """Fill x, y, z and w, as far as there are values."""
    for name, value in zip('xyzw', values, strict=False):
        setattr(message, name, value)
    return message
