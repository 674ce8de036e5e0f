# SPDX-License-Identifier: Apache-2.0
"""The planar worlds over the wire: contacts, discrete actions and snapshots, bit for bit."""
from __future__ import annotations

import signal
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rocket_msgs import msg
from support.processes import Processes
from support.training.rollouts import assert_same

from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.pilots.expert.expert import ExpertPilot
from ppo_agent_node.pilots.lunar_heuristic import LunarHeuristic
from rocket_sim_node import worlds
from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.worlds import EnvironmentRestarted
from rocket_sim_node.worlds import WorldSpec

N = 8
MakeClient = Callable[..., Client]
WORLDS = [
    ('lunar_lander', {}), ('lunar_lander', {'continuous': True}), ('rocket_planar', {}),
]


def pilot_of(spec: WorldSpec) -> Pilot:
    """Return a pilot that lands most vehicles gently, so that there is contact."""
    return LunarHeuristic(spec) if spec.name == 'lunar_lander' else ExpertPilot(spec)


@pytest.mark.parametrize(('world', 'settings'), WORLDS)
def test_same_rollout_in_process_over_dds_and_across_a_kill(
    world: str, settings: dict[str, Any], processes: Processes, make_client: MakeClient,
) -> None:
    """A killed simulator is put back from a snapshot taken with landers on the ground."""
    start = {'world': world, 'num_envs': N, **settings}
    simulator = processes.fork_node('rocket_sim_node', 'simulator', **start)
    client = make_client(patience=30.0)
    local = worlds.make(world, num_envs=N, seed=3, **settings)
    client.connect()
    assert client.spec == local.spec
    observation = client.reset(11)
    np.testing.assert_array_equal(observation, local.reset(11))
    pilot = pilot_of(local.spec)
    touched = episodes = 0

    def fly(steps: int) -> None:
        nonlocal observation, touched, episodes
        for _ in range(steps):
            action = pilot(observation)
            ours = client.step(action)
            assert_same(ours, local.step(action))
            observation = ours[0]
            touched += int(local.telemetry(np.arange(N)).contact.any())
            episodes += len(ours[4]['episodes'])

    fly(700)
    while not local.telemetry(np.arange(N)).contact.any():
        fly(1)
    state = client.snapshot()
    assert state == local.snapshot()
    simulator.signal(signal.SIGKILL)
    simulator.wait(5.0)
    processes.fork_node('rocket_sim_node', 'simulator', **start)
    with pytest.raises(EnvironmentRestarted):
        client.step(pilot(observation))
    np.testing.assert_array_equal(client.restore(state), observation)
    fly(300)
    assert touched > 20
    assert episodes > 5


@pytest.mark.parametrize('world', ['lunar_lander', 'rocket_planar'])
def test_state_holds_legs_contact_and_ground(
    world: str, processes: Processes, make_client: MakeClient,
) -> None:
    processes.fork_node('rocket_sim_node', 'simulator', world=world, num_envs=N)
    client = make_client()
    states: list[msg.RocketState] = []
    client.node.create_subscription(msg.RocketState, 'state', states.append, qos.EVENTS)
    spec = client.connect()
    client.waiter.until(lambda: client.node.count_publishers('state') > 0, 10.0)
    observation = client.reset(2)
    pilot = pilot_of(spec)
    for _ in range(600):
        observation = client.step(pilot(observation))[0]
    client.close()
    client.waiter.until(lambda: any(max(s.step) >= 600 for s in states), 20.0)
    count = sum(len(s.row) for s in states)
    contact = np.concatenate([np.reshape(s.contact, (-1, 2)) for s in states])
    force = np.concatenate([np.reshape(s.contact_force, (-1, 3)) for s in states])
    assert len(contact) == len(force) == count > 0
    standing = contact.all(axis=1)
    assert standing.any()
    # z is up, and the ground pushes.
    assert (force[standing, 2] > 0).mean() > 0.9
    assert (force[:, 1] == 0).all()
    flying = ~contact.any(axis=1)
    if world == 'rocket_planar':
        assert (force[flying] == 0).all()
    heights = 11 if world == 'lunar_lander' else 0
    assert sum(len(s.terrain) for s in states) == heights * count
    assert sum(len(s.leg_angle) for s in states) == 2 * count
