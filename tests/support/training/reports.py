# SPDX-License-Identifier: Apache-2.0
"""Small run folders for tests of reports, with invented or flown figures."""
from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.evaluation import episode_table
from ppo_agent_node.evaluation.metrics import summarise
from ppo_agent_node.evaluation.metrics import write_json
from ppo_agent_node.evaluation.runner import EvaluationResult
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.random import RandomPilot
from ppo_agent_node.pilots.scripted import scripted_pilot
from rocket_sim_node import worlds


@cache
def flown(
    world: str = 'rocket', pilot: str = 'expert', episodes: int = 60, **settings: float,
) -> EvaluationResult:
    """Fly a few episodes as one batch; results are cached."""
    env = worlds.make(world, num_envs=episodes)
    flier = scripted_pilot(env.spec) if pilot == 'expert' else RandomPilot(env.spec, 3)
    return evaluate(env, flier, episodes, 5, **settings)


def write_evaluation(folder: Path, result: EvaluationResult) -> Path:
    """Write the files of an evaluation, except its pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / 'evaluation.json', summarise(result))
    episode_table.write(folder / 'episodes.csv', episode_table.from_result(result))
    return folder


def write_training(
    folder: Path, seed: int = 1, iterations: int = 6, first_step: int = 1000, slope: float = 1.0,
    scores: bool = False, **settings: Any,
) -> Path:
    """Write settings and log of a run whose return rises from `seed` by `slope` per iteration."""
    folder.mkdir(parents=True, exist_ok=True)
    config = {
        'version': '0.1.0', 'world': 'rocket', 'num_envs': 4,
        'training': json.loads(json.dumps(
            load_preset('default', 'rocket', seed=seed, **settings).flat())),
        'world_settings': worlds.make('rocket').spec.settings}
    (folder / 'config.yaml').write_text(yaml.safe_dump(config, sort_keys=False))
    lines: list[dict[str, Any]] = [
        {'stage': 'demonstrate', 'iteration': 1, 'steps': first_step, 'seconds': 30.0}]
    lines += [
        {'stage': 'clone', 'iteration': epoch, 'steps': first_step, 'clone_loss': 1 / epoch,
         'clone_validation_loss': 1.5 / epoch, 'seconds': 15.0} for epoch in (1, 2)]
    for iteration in range(iterations):
        line = {
            'stage': 'finetune', 'iteration': iteration, 'steps': first_step + 100 * iteration,
            'level': 1 + iteration // 2, 'seconds': 60.0}
        if iteration:
            line |= {
                'episodes': 2, 'landing_rate': 0.5, 'landing_rate_low': 0.1,
                'landing_rate_high': 0.9, 'mean_return': seed + slope * iteration,
                'policy_loss': 0.1, 'value_loss': 0.2, 'explained_variance': 0.5,
                'approx_kl': 0.01, 'clipfrac': 0.1, 'entropy': -1.0, 'learning_rate': 1e-4,
                'log_std': -2.0}
        if iteration % 2 == 0:
            line |= {'selection_return': 10.0 * seed + iteration, 'selection_landing_rate': 1.0}
        if scores:
            line['scores'] = [1.0 * iteration, 2.0 * iteration]
        lines.append(line)
    (folder / 'train.jsonl').write_text(''.join(json.dumps(line) + '\n' for line in lines))
    return folder
