# SPDX-License-Identifier: Apache-2.0
"""Small training runs, in this process or as nodes, and comparisons between them."""
from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file

from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.evaluation import metrics
from ppo_agent_node.evaluation.optimum_sample import solve_sample
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.runs import tensor_file
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.runs.metrics_logger import TIMES
from ppo_agent_node.training.trainer import Trainer
from rocket_sim_node.worlds import VectorEnv
from rocket_sim_node.worlds import make
from rocket_sim_node.worlds.jobs import SerialFleet
from support.processes import Process
from support.processes import Processes

SMALL = {
    'demonstration_episodes': 16, 'dagger_rounds': 1, 'dagger_epochs': 1, 'clone_epochs': 2,
    'hidden_sizes': '[16,16]', 'iterations': 4,
    'n_steps': 64, 'batch_size': 256, 'selection_interval': 2, 'selection_episodes': 8,
    'evaluation_episodes': 20, 'plots': False, 'checkpoint_interval': 1, 'threads': 1,
    'seed': 5, 'critic_warmup_iterations': 1,
    'curriculum_start_level': 3, 'curriculum_final_level': 3, 'curriculum_wide_level': 4,
}
"""Settings of a run that takes seconds and lands no rocket."""

GENTLE: dict[str, Any] = {
    'demonstration_episodes': 8, 'demonstration_noise': 0.05, 'teacher_braking_share': 0.8,
    'teacher_flare_rate': 3.0, 'teacher_flare_speed': 0.1,
    'clone_epochs': 1, 'clone_batch_size': 256,
    'hidden_sizes': (16, 16), 'iterations': 6, 'n_steps': 40, 'scatter_steps': 60,
    'batch_size': 64, 'critic_warmup_iterations': 2, 'threads': 1, 'checkpoint_interval': 3,
    'selection_interval': 4, 'selection_episodes': 8, 'curriculum_landing_rate': 0.0,
    'curriculum_window': 1, 'curriculum_final_level': 3, 'actor_learning_rate': 1e-3,
}
"""Settings of a run in process, with a gentle teacher, which lands in spite of the noise."""

_NODE = 'rocket_sim_node', 'simulator'

LOW = {'spawn_height': 40.0, 'time_limit': 6.0}
"""Settings of its world: a flight takes 4 s, and the expert lands on the levels of `SMALL`."""


def simulator(processes: Processes, world: str = 'rocket', namespace: str = '') -> Process:
    """Start a simulator of eight rockets, forked (see `support.forking`)."""
    remap = (f'__ns:={namespace}',) if namespace else ()
    return processes.fork_node(*_NODE, remap, **_simulated(world))


def fresh_simulator(processes: Processes) -> Process:
    """Start the same as a user does, for tests of starts and of their interruption."""
    return processes.run_node(*_NODE, **_simulated('rocket'))


def make_world(world: str = 'rocket') -> VectorEnv:
    """Make the world of such a simulator in this process."""
    return make(world, num_envs=8, **_start(world))


def _simulated(world: str) -> dict[str, Any]:
    return {'world': world, 'num_envs': 8, **_start(world)}


def _start(world: str) -> dict[str, float]:
    return {} if world == 'lunar_lander' else LOW


def agent(processes: Processes, run: Path, **parameters: object) -> Process:
    """Start a small training run, forked (see `support.forking`)."""
    return processes.fork_node(
        'ppo_agent_node', 'ppo_agent', run_dir=run, **{**SMALL, **parameters})


def fresh_agent(processes: Processes, run: Path, **parameters: object) -> Process:
    """Start the same as a user does, for tests of starts and of their interruption."""
    return processes.run_node(
        'ppo_agent_node', 'ppo_agent', run_dir=run, **{**SMALL, **parameters})


def weights(run: Path) -> dict[str, torch.Tensor]:
    """Return the learnt tensors of the last checkpoint of a run."""
    tensors = load_file(max((run / 'checkpoints').glob('iteration_*.safetensors')))
    return {name: value for name, value in tensors.items() if not name.startswith('world')}


def log_without_times(run: Path, but: tuple[str, ...] = ()) -> list[dict]:
    """Return the lines of train.jsonl without times, and without the entries in `but`."""
    lines = RunFolder(run, resume=True).lines()
    return [{k: v for k, v in line.items() if k not in (*TIMES, *but)} for line in lines]


def left_by(run: Path) -> dict[str, Any]:
    """Return the newest checkpoint, the policy and the log of a run, without times."""
    folder = RunFolder(run, resume=True)
    newest = folder.newest(pytest.fail)
    assert newest is not None
    left: dict[str, Any] = {'log': log_without_times(run)}
    for kind, saved in (
            ('checkpoint', newest[1]), ('policy', tensor_file.read(folder.policy, 'policy'))):
        left[kind] = saved.content
        left |= {f'{kind}.{name}': each.numpy().tobytes()
                 for name, each in saved.tensors.items()}
    return left


def assert_same_run(first: Path, second: Path, but: tuple[str, ...] = ()) -> None:
    """Assert that two runs have the same weights, bit for bit, and the same log except `but`."""
    ours, theirs = weights(first), weights(second)
    assert ours.keys() == theirs.keys()
    for name in ours:
        assert torch.equal(ours[name], theirs[name]), name
    assert log_without_times(first, but) == log_without_times(second, but)


def train_in_process(run: Path, world: str = 'rocket', **parameters: Any) -> Path:
    """Train as `agent` does, without ROS, and return the folder."""
    values = {**SMALL, 'hidden_sizes': json.loads(str(SMALL['hidden_sizes'])), **parameters}
    result = Trainer(
        SerialFleet(make_world(world)), load_preset('default', world, **values),
        RunFolder(run)).run()
    assert result.finished
    return run


def evaluate_in_process(run: Path) -> Path:
    """Write `evaluation.json` of such a run, as `agent` does, and return the folder."""
    world, config = make_world(), load_preset('default')
    result = evaluate(
        world, PolicyPilot(run / 'policy.safetensors', world.spec), SMALL['evaluation_episodes'],
        config.run.evaluation_seed, level=SMALL['curriculum_final_level'])
    metrics.write_json(run / 'evaluation.json', metrics.summarise(
        result, **solve_sample(result).figures(result), messages_dropped=0,
        training_seed=SMALL['seed']))
    return run
