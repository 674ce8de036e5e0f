# SPDX-License-Identifier: Apache-2.0
"""Trains the runs of an experiment in process, with the same results as over DDS.

A finished run is used as it is, and an interrupted one is resumed, so a sweep can be stopped at
any time.
"""
from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from dataclasses import field
from pathlib import Path
from typing import Any

from benchmarks import machine
from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.config.training_config import Config
from ppo_agent_node.evaluation.metrics import write_json
from ppo_agent_node.ppo.policies.file import POLICY
from ppo_agent_node.runs import tensor_file
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.training.trainer import Trainer
from rocket_sim_node import worlds
from rocket_sim_node.telemetry.training_status import Status
from rocket_sim_node.worlds.jobs import SerialFleet

_NOTE = 'trained.json'


@dataclass(frozen=True)
class Recipe:
    """A training method: a preset of a world with some settings changed."""

    name: str
    preset: str = 'default'
    overrides: Mapping[str, object] = field(default_factory=dict)
    num_envs: int = 256
    """rockets or landers in the world"""
    world: str = 'rocket'

    def config(self, seed: int) -> Config:
        """Return the settings of a run with this seed.

        :raises ValueError: for an unknown setting, or a value out of range.
        """
        values = {'threads': 1, 'device': 'cpu', **self.overrides}
        return load_preset(self.preset, self.world, **values, seed=seed)


@dataclass(frozen=True)
class Trained:
    """A finished run."""

    recipe: str
    seed: int
    folder: RunFolder
    cpu_seconds: float
    """of the training, without the flights of the experiment"""
    commit: str
    """of the training"""

    def policy(self, stage: str) -> Path:
        """Return a policy of the run: `cloned`, `policy` (the best one) or `last`.

        The last policy need not be the best. Its file is written on the first call.
        """
        path = self.folder.path / f'{stage}.safetensors'
        if stage == 'last' and not path.exists():
            checkpoint = self.folder.newest(lambda message: None)
            assert checkpoint is not None
            best = tensor_file.read(self.folder.policy, POLICY)
            tensor_file.write(path, POLICY, {
                name: checkpoint[1].tensors[f'policy.{name}'] for name in best.tensors},
                best.content)
        return path

    def note(self) -> dict[str, Any]:
        """Return the facts about the run that are stored with the figures."""
        return {
            'recipe': self.recipe, 'seed': self.seed, 'cpu_seconds': self.cpu_seconds,
            'commit': self.commit}


def train(recipe: Recipe, seed: int, runs: Path) -> Trained:
    """Train with a seed in a folder below `runs`, or return the existing run.

    :raises ValueError: if the existing run has other settings; the message names them.
    """
    folder = RunFolder(runs / f'{recipe.name}-{seed}', resume=True)
    note, config = folder.path / _NOTE, recipe.config(seed)
    if not note.exists():
        began, commit = time.process_time(), machine.commit()
        seen: dict[str, Any] = {} if recipe.world == 'lunar_lander' else {
            'observation': config.curriculum.observation}
        world = worlds.make(recipe.world, recipe.num_envs, **seen)
        with folder.locked():
            result = Trainer(SerialFleet(world), config, folder, _tell(folder.name)).run()
        assert result.finished
        write_json(note, {
            'cpu_seconds': round(time.process_time() - began, 1), 'commit': commit,
            'num_envs': recipe.num_envs})
    found = json.loads(note.read_text('utf-8'))
    _expect(folder, {**config.flat(), 'num_envs': recipe.num_envs},
            {**folder.read_config()['training'], 'num_envs': found['num_envs']})
    return Trained(recipe.name, seed, folder, found['cpu_seconds'], found['commit'])


def _expect(folder: RunFolder, wanted: dict[str, Any], found: dict[str, Any]) -> None:
    wanted = json.loads(json.dumps(wanted))
    names = sorted(
        name for name in {*wanted, *found} - {'plots'}  # which no training depends on
        if wanted.get(name) != found.get(name))
    if names:
        raise ValueError(
            f'{folder.path}: trained with another value of {", ".join(names)}; move it away, or '
            'name another folder with --runs')


def _tell(name: str) -> Any:
    def tell(status: Status) -> None:
        if status.message:
            print(f'  {name} {status.stage} {status.iteration}: {status.message}', flush=True)
    return tell
