# SPDX-License-Identifier: Apache-2.0
"""Trains one example of docs/examples with one seed, and records its episodes.

The example is not changed: its `train` runs as it is, and patched environments report their
episodes to this module. `train` is stopped when the last 100 episodes return the target on
average, or when its steps are used up.
"""
from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import runpy
import sys
import time
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np

from rocket_sim_node import gym
from rocket_sim_node.gym.curriculum import ReverseCurriculum
from rocket_sim_node.gym.vector_env import HoverslamVectorEnv

EXAMPLES = Path(__file__).parents[3] / 'docs' / 'examples'
WINDOW = 100
"""number of episodes in a moving average"""
POINTS = 200
"""maximum number of points in a curve"""


ROCKETS: dict[str, dict[str, Any]] = {
    'sb3_sac': {}, 'single_file_ppo': {
        'num_envs': 256, 'num_steps': 128, 'minibatches': 8, 'epochs': 4,
        'learning_rate': 1e-3, 'gamma': 0.998, 'entropy_weight': 0.0}}
"""additional arguments of an example for rockets; examples not listed use 256 rockets"""


class ReachedError(Exception):
    """Raised when the target is reached or the steps are used up."""


class Recorder:
    """Records the episodes that end in the environments of this process."""

    def __init__(self, target: float, most_steps: int) -> None:
        """Start at step 0.

        :param target: mean return at which to stop.
        """
        self.steps, self.passed = 0, False
        self.curve: list[dict[str, float]] = []
        """steps, processor seconds, and mean return and landing rate of the last 100 episodes"""
        self.reach: float | None = None
        """m, of the reverse curriculum; 0 when it is over"""
        self._target, self._most = target, most_steps
        self._returns: deque[float] = deque(maxlen=WINDOW)
        self._landed: deque[bool] = deque(maxlen=WINDOW)
        self._following, self._began = 0.0, time.process_time()

    def stepped(self, num_envs: int, info: dict[str, Any]) -> None:
        """Record a step of all environments.

        :raises ReachedError: if the training is to end.
        """
        self.steps += num_envs
        if 'final_info' in info:
            final, ended = info['final_info'], info['_final_info']
            self._returns.extend(final['episode_return'][ended].tolist())
            self._landed.extend(final['is_success'][ended].tolist())
        full = len(self._returns) == WINDOW
        self.passed = full and float(np.mean(self._returns)) >= self._target
        if self.passed or self.steps >= self._most:
            raise ReachedError
        if full and self.steps >= self._following:
            self._following += self._most / POINTS
            self.note()

    def note(self) -> None:
        """Add a point to the curve."""
        self.curve.append({
            'steps': self.steps, 'cpu_seconds': time.process_time() - self._began,
            'mean_return': float(np.mean(self._returns)) if self._returns else math.nan,
            'landed': float(np.mean(self._landed)) if self._landed else math.nan,
            **({} if self.reach is None else {'reach': self.reach})})

    def attach(self) -> None:
        """Patch the environments, so that all of this process are recorded from now on."""
        step, begin = HoverslamVectorEnv.step, ReverseCurriculum._begin

        def recorded(env: HoverslamVectorEnv, actions: Any) -> Any:
            found = step(env, actions)
            self.stepped(env.num_envs, found[4])
            return found

        def begun(envs: ReverseCurriculum, seed: int | None, reach: float, options: Any) -> Any:
            self.reach = 0.0 if envs.over else reach
            return begin(envs, seed, reach, options)

        HoverslamVectorEnv.step = recorded  # type: ignore[method-assign]
        ReverseCurriculum._begin = begun  # type: ignore[method-assign]


def train(example: str, world: str, seed: int, steps: int, target: float) -> dict[str, Any]:
    """Train an example and return its results."""
    module = runpy.run_path(str(EXAMPLES / f'{example}.py'))
    settings: dict[str, Any] = {'name': gym.IDS[world], 'seed': seed, 'steps': steps}
    if world != 'lunar_lander':
        settings |= {'curriculum': True, **ROCKETS.get(example, {'num_envs': 256})}
    recorder = Recorder(target, steps)
    recorder.attach()
    with contextlib.suppress(ReachedError), open(os.devnull, 'w') as nowhere, (
            contextlib.redirect_stdout(nowhere)):
        if 'Options' in module:
            module['train'](module['Options'](**settings))
        else:
            module['train'](**settings)
    recorder.note()
    return {
        'example': example, 'world': world, 'seed': seed, 'passed': recorder.passed,
        'steps': recorder.steps, 'reach': recorder.reach, 'curve': recorder.curve,
        'cpu_seconds': recorder.curve[-1]['cpu_seconds']}


def main() -> None:
    """Train, and print the results as a line of JSON."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('example')
    parser.add_argument('world')
    parser.add_argument('seed', type=int)
    parser.add_argument('steps', type=int)
    parser.add_argument('target', type=float)
    sys.stdout.write(json.dumps(train(**vars(parser.parse_args()))) + '\n')


if __name__ == '__main__':
    main()
