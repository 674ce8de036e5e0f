# SPDX-License-Identifier: Apache-2.0
"""Time of each part of one lock-step step in a training roll-out.

There is one simulator and one agent, whose policy learns. The agent's parts are timed during
a roll-out over DDS; the simulator's parts, and those of inference, are timed in this process, with
the same rockets. The rest of inference is the noise, and what it takes longer in a roll-out than
alone. The agent records the results of a step while it waits for the next one. The rest of that
wait is communication: DDS, the kernel, and waking threads. The lower bound is the time that TCP
takes for the same bytes, with one core per process.
"""
from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rocket_msgs import msg

from benchmarks.training_speed.rollouts import Course
from benchmarks.training_speed.rollouts import shipped_policy
from benchmarks.training_speed.rollouts import wire_fleet
from benchmarks.wire.exchange import microseconds
from benchmarks.wire.exchange import on_core
from benchmarks.wire.tcp_floor import TcpFloor
from ppo_agent_node.evaluation.metrics import write_json
from ppo_agent_node.ppo.networks.mlp import quick
from ppo_agent_node.ppo.policies.factory import Policy
from rocket_sim_node import worlds
from rocket_sim_node.wire.client.answers import Answers
from rocket_sim_node.wire.client.connection import Connection
from rocket_sim_node.wire.messages.cdr import Codec
from rocket_sim_node.wire.node.polling import PollingWaitSet
from rocket_sim_node.worlds.actions import checked_action


class Stopwatch:
    """Adds up the time that methods take, without that of timed methods which they call."""

    def __init__(self) -> None:
        """Start without any methods to time."""
        self.seconds: dict[str, float] = defaultdict(float)
        self._put_back: list[Callable[[], None]] = []
        self._inner = [0.0]
        """Time of the timed methods called so far by each method that runs, the innermost last."""

    def time(self, owner: Any, name: str, what: str) -> None:
        """Time a method of a class."""
        method = getattr(owner, name)

        def timed(*args: Any, **options: Any) -> Any:
            start = time.perf_counter()
            self._inner.append(0.0)
            try:
                return method(*args, **options)
            finally:
                whole = time.perf_counter() - start
                self.seconds[what] += whole - self._inner.pop()
                self._inner[-1] += whole

        setattr(owner, name, timed)
        self._put_back.append(lambda: setattr(owner, name, method))

    def end(self) -> None:
        """Restore the original methods."""
        for put_back in self._put_back:
            put_back()


class TimedPolicy:
    """A policy whose sampling is timed."""

    def __init__(self, policy: Policy, watch: Stopwatch) -> None:
        """Wrap a policy."""
        self._policy, self._watch = policy, watch

    def __getattr__(self, name: str) -> Any:
        return getattr(self._policy, name)

    def sampler(self, *args: Any) -> Any:
        """Return the policy's sampler, with its calls timed."""
        sample = self._policy.sampler(*args)

        def timed(step: int, observation: Any) -> Any:
            start = time.perf_counter()
            action = sample(step, observation)
            self._watch.seconds['inference'] += time.perf_counter() - start
            return action

        return timed


def simulator_pieces(num_envs: int, count: int) -> dict[str, float]:
    """Return the median times, us, of the parts of a simulator's step, without waiting."""
    world = worlds.make('rocket', num_envs, level=7)
    world.reset(1)
    spec, actions = world.spec, Codec(msg.Action)
    command = np.zeros((num_envs, 3), np.float32)
    data = actions.encode((1, 2, 3), (command, np.zeros(0)))
    observation, reward, terminated, truncated, info = world.step(command)
    results = Codec(msg.Observation), Codec(msg.Reward)

    def read() -> None:
        checked_action(spec, actions.decode(data).continuous.reshape(num_envs, 3))

    def fill() -> None:
        results[0].encode((1, 2), (observation,))
        results[1].encode((1, 2), (
            reward, terminated, truncated, info['final_rows'], info['final_observation']))

    return {
        'take, check action': microseconds(read, count)[0],
        'physics': microseconds(lambda: world.step(command), count)[0],
        'fill observation, reward': microseconds(fill, count)[0],
        'capture states': microseconds(lambda: world.capture(slice(0, 4)), count)[0]}


def inference_pieces(policy: Policy, num_envs: int, count: int) -> dict[str, float]:
    """Return the median times, us, of the parts of inference, each repeated alone."""
    observation = torch.tensor(worlds.make('rocket', num_envs, level=7).reset(1))
    layers = policy.network.without_gradients()
    normalised = policy.normaliser(observation)
    seen = quick(policy.normaliser, lambda x: x)
    with torch.inference_mode():
        return {
            'inference: features': microseconds(lambda: seen(observation), count)[0],
            'inference: network': microseconds(lambda: layers(normalised), count)[0]}


def measure(num_envs: int, steps: int, rounds: int, policy: Policy) -> list[dict[str, Any]]:
    """Return the times of the parts of a step, in their order."""
    found: dict[str, list[float]] = defaultdict(list)
    floor = TcpFloor(num_envs, core=1)
    with tempfile.TemporaryDirectory() as folder, wire_fleet(
            Path(folder), 1, num_envs) as fleet:
        watch = Stopwatch()
        course = Course(fleet, 1, steps, TimedPolicy(policy, watch))  # type: ignore[arg-type]
        course()
        try:
            for owner, name, what in (
                # Beside what is timed apart, it checks and records the last results.
                (Connection, 'ask', 'wait'),
                (Connection, '_send', 'check, fill, publish action'),
                (PollingWaitSet, 'wait', 'wait'),
                (Connection, 'poll', 'take observation, reward'),
                (Answers, 'collect', 'take observation, reward'),
                (Answers, 'take_observation', 'check observation'),
            ):
                watch.time(owner, name, what)
            for _ in range(rounds):
                watch.seconds.clear()
                rate = course()
                whole = 1e6 * num_envs / rate
                pieces = {name: 1e6 * s / steps for name, s in watch.seconds.items()}
                pieces['buffers, bookkeeping'] = whole - sum(pieces.values())
                for name, value in {**pieces, 'whole step': whole}.items():
                    found[name].append(value)
                with on_core(0):
                    found['floor: TCP, a core each'].append(microseconds(floor, steps)[0])
        finally:
            watch.end()
            floor.close()
    agent = {name: statistics.median(values) for name, values in found.items()}
    simulator = simulator_pieces(num_envs, 20 * rounds)
    inference = inference_pieces(policy, num_envs, 20 * rounds)
    inference['inference: rest'] = agent.pop('inference') - sum(inference.values())
    agent = {**inference, **agent}
    # With what the agent does meanwhile.
    wait, whole = agent.pop('wait'), agent.pop('whole step')
    tcp = agent.pop('floor: TCP, a core each')
    rows = [{'who': 'agent', 'what': name, 'us': value} for name, value in agent.items()]
    rows += [{'who': 'simulator', 'what': n, 'us': value} for n, value in simulator.items()]
    rows += [
        {'who': 'between', 'what': 'DDS, kernel, wake-ups', 'us': wait - sum(simulator.values())},
        {'who': '', 'what': 'whole step', 'us': whole},
        {'who': '', 'what': 'floor: TCP, a core each', 'us': tcp}]
    return rows


def main() -> None:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(prog='bench budget', description=__doc__.split('\n')[0])
    parser.add_argument('--rounds', type=int, default=9, help='number of rounds')
    parser.add_argument('--steps', type=int, default=256, help='steps per rocket in a roll-out')
    parser.add_argument('--num-envs', type=int, default=256, help='number of rockets')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    rows = measure(options.num_envs, options.steps, options.rounds, shipped_policy())
    whole = next(row['us'] for row in rows if row['what'] == 'whole step')
    print(f'a step of {options.num_envs} rockets, us, medians of {options.rounds} roll-outs')
    for row in rows:
        print(f'{row["who"]:<11}{row["what"]:<32}{row["us"]:>8.0f}{row["us"] / whole:>8.0%}')
    if options.output:
        write_json(options.output, {'num_envs': options.num_envs, 'budget': rows})


if __name__ == '__main__':
    main()
