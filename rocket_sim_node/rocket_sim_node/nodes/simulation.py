# SPDX-License-Identifier: Apache-2.0
"""Body of node `simulator`: create a world from parameters and serve it to an agent."""
from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.executors import Executor
from rclpy.node import Node
from rocket_msgs.msg import World

from rocket_sim_node import worlds
from rocket_sim_node.settings import SettingInfo
from rocket_sim_node.settings import setting
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages.conversion import MOST_ENVS
from rocket_sim_node.wire.node.parameters import ParameterError
from rocket_sim_node.wire.node.parameters import Parameters
from rocket_sim_node.wire.server.server import Server
from rocket_sim_node.wire.server.server import ServerOptions
from rocket_sim_node.worlds.base import SimulatedWorld
from rocket_sim_node.worlds.rocket import conditions

_ONE_OBSERVATION = SettingInfo(
    'observation', 'standard', '', 'what pilots see', 0.0, math.inf, ('standard',))
"""Setting for worlds with only one kind of observation."""
_MODES = {'lockstep': World.LOCKSTEP, 'realtime': World.REALTIME}


@dataclass(frozen=True)
class SimulatorParameters:
    """Parameters of the node itself; the world's are declared beside them."""

    world: str = setting('rocket', '', 'which world', choices=worlds.names())
    num_envs: int = setting(256, '', 'number of rockets, stepped as one batch', 1, MOST_ENVS)
    seed: int = setting(0, '', 'seed of the random streams until the first reset', 0, 2**62)
    conditions: str = setting(
        'nominal', '', 'set of conditions; rocket worlds only. Conditions that are set '
        'individually take precedence', choices=conditions.NAMES)
    mode: str = setting(
        'lockstep', '', 'lockstep: one step per action; realtime: by the '
        'clock', choices=tuple(_MODES))
    realtime_factor: float = setting(
        1.0, '', 'simulated seconds per second; realtime only', 0.01, 100.0)
    action_timeout: float = setting(
        0.5, 's', 'time without a new action, at least 2.5 steps, after which the engine is cut; '
        'realtime only', 0.01, 3600.0)
    agent_lease: float = setting(
        10.0, 's', 'silence of the agent after which another may take over; in lock-step, an '
        'agent that is computing an update reports every 0.5 s', 0.0, 3600.0)
    acknowledge: str = setting(
        'auto', '', 'whether actions are acknowledged, so that DDS repeats lost ones; auto: if '
        'the discovery range extends beyond this machine', choices=qos.ACKNOWLEDGE)
    state_rows: int = setting(
        4, '', 'number of rockets, from the first, on topic `state`', 0, 1024)
    state_batch: int = setting(
        50, '', 'number of steps in one message of `state`; lockstep only', 1, 10_000)


def _world_settings(parameters: Parameters, options: SimulatorParameters) -> dict[str, Any]:
    """Declare the world's settings and return their values.

    :raises ParameterError: for a value out of range, or a setting that this world lacks.
    """
    infos = worlds.settings(options.world)
    known = {info.name for info in infos}
    if known.issuperset(conditions.FLAT_NAMES):
        return parameters.declare_infos(infos, conditions.settings(options.conditions))
    if options.conditions != 'nominal':
        raise ParameterError(
            f'parameter conditions: got {options.conditions!r}, expected nominal, as world '
            f'{options.world!r} has no others')
    # Launch files pass it to every world.
    values = parameters.declare_infos((*infos, _ONE_OBSERVATION))
    del values[_ONE_OBSERVATION.name]
    return values


def _offer_services(
    node: Node, server: Server, world: SimulatedWorld, seed: int,
) -> Callable[[Executor], None]:
    """Offer the services of simulation_interfaces, if that package is there.

    :return: what removes them from DDS.
    """
    try:
        from rocket_sim_node.nodes.simulation_services import SimulationServices
    except ImportError as error:
        if not str(error.name).startswith('simulation_interfaces'):
            raise
        node.get_logger().info(f'the services of simulation_interfaces are not offered: {error}')
        return lambda _: None
    return SimulationServices(node, server, world, seed).destroy


def simulate(node: Node, executor: Executor) -> None:
    """Serve a world until asked to stop."""
    parameters = Parameters(node)
    options = parameters.declare(SimulatorParameters)
    stepping = parameters.declare(worlds.SteppingSettings)
    settings = _world_settings(parameters, options)
    parameters.finish()
    world = worlds.make(
        options.world, options.num_envs, options.seed, stepping.step_threads, **settings)
    server = Server(node, world, ServerOptions(
        mode=_MODES[options.mode], realtime_factor=options.realtime_factor,
        action_timeout=options.action_timeout, agent_lease=options.agent_lease,
        acknowledge=options.acknowledge, state_rows=options.state_rows,
        state_batch=options.state_batch))
    withdraw = _offer_services(node, server, world, options.seed)
    node.get_logger().info(
        f'world {options.world!r}, {options.num_envs} rockets, {options.mode}, '
        f'level {settings.get("level", "-")}, {conditions.name_of(settings)} conditions: '
        'waiting for an agent')
    try:
        server.serve(executor)
    finally:
        withdraw(executor)
