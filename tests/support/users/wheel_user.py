# SPDX-License-Identifier: Apache-2.0
"""A user's script, run and type-checked in an environment with only the wheels, without ROS."""
from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import gymnasium
import numpy as np
from numpy.typing import NDArray

import rocket_sim_node.gym
from ppo_agent_node.commands.compare import Comparison
from ppo_agent_node.commands.compare import make as compare
from ppo_agent_node.commands.report import write_report
from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.evaluation import metrics
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.choice import choose
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.pilots.search import find_policy
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.training.trainer import Trainer
from rocket_sim_node import worlds
from rocket_sim_node.worlds.jobs import SerialFleet


def fly(name: str) -> float:
    """Return the mean reward of a hundred random steps in a world."""
    world: worlds.VectorEnv = worlds.make(name, num_envs=16, seed=1)
    random = np.random.default_rng(0)
    observation: NDArray[np.float32] = world.reset()
    total = 0.0
    for _ in range(100):
        action = random.integers(0, 4, 16) if name == 'lunar_lander' else random.uniform(
            -1, 1, (16, 3)).astype(np.float32)
        observation, reward, _, _, _ = world.step(action)
        total += float(reward.mean())
    assert observation.shape == (16, world.spec.observation_size)
    return total / 100


def adapters() -> None:
    """Step the vector environment and a single environment of each world."""
    for name in rocket_sim_node.gym.IDS.values():
        envs = gymnasium.make_vec(name, num_envs=4, seed=1)
        envs.reset()
        envs.step(envs.action_space.sample())
        envs.close()
        env = gymnasium.make(name, render_mode='rgb_array')
        env.reset(seed=1)
        env.step(env.action_space.sample())
        picture: object = env.render()
        assert isinstance(picture, np.ndarray)
        env.close()


def train(folder: Path) -> Path:
    """Train briefly and return the file of the policy."""
    world = worlds.make('rocket', num_envs=8, seed=1, level=7)
    config = load_preset(
        'quick', 'rocket', demonstration_episodes=8, clone_epochs=1, hidden_sizes=(16, 16),
        iterations=1, n_steps=32, batch_size=256, selection_interval=1, selection_episodes=8,
        critic_warmup_iterations=1, threads=1)
    result = Trainer(SerialFleet(world), config, RunFolder(folder)).run()
    assert result.finished
    return result.policy


def main() -> None:
    """Run all functions above in a folder."""
    folder = Path(sys.argv[1])
    assert importlib.util.find_spec('rclpy') is None, 'ROS is not expected here'
    assert importlib.util.find_spec('rocket_msgs') is None
    for name in worlds.names():
        print(f'{name}: {fly(name):.3f}')
    adapters()
    run = folder / 'run'
    policy = train(run)
    world = worlds.make('rocket', num_envs=8, level=7)
    for pilot in (PolicyPilot(policy, world.spec),
                  PolicyPilot(find_policy('default', 'rocket'), world.spec),
                  choose('expert', world.spec).pilot):
        result = evaluate(world, pilot, episodes=16, seed=20_000_000)
    summary = metrics.summarise(result)
    assert summary['landed'] == 16
    metrics.write_json(run / 'evaluation.json', summary)
    print(write_report(run))
    print(compare(Comparison(run_dir=str(run), episodes=1, level=1)))
    assert (run / 'comparison.rrd').stat().st_size > 10_000


if __name__ == '__main__':
    main()
