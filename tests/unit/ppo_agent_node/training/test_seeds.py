# SPDX-License-Identifier: Apache-2.0
"""Seeds: training, selection and evaluation never use the same starts."""
from __future__ import annotations

import argparse
import itertools
import json
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.learning import seeds as bench_seeds
from numpy.typing import NDArray
from support.training.training_runs import SMALL

from ppo_agent_node import random_streams
from ppo_agent_node.commands import pictures
from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.config.training_config import RunConfig
from ppo_agent_node.evaluation import conditions_table
from ppo_agent_node.evaluation import tuning
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.random import RandomPilot
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.training.trainer import Trainer
from rocket_sim_node import worlds
from rocket_sim_node.telemetry.training_status import Status
from rocket_sim_node.worlds.jobs import SerialFleet

EVALUATIONS = (
    RunConfig.evaluation_seed, conditions_table.SEED, pictures.SEED, bench_seeds.SEED, 60_000_000)
"""where starts of published figures begin; the last is in the documents"""
TRAINING, SELECTION = ('demonstrations', 'dagger', 'world', 'starts'), 'selection'
"""purposes of the seeds that worlds are reset with"""


def test_seeds_of_training_selection_evaluation_and_tuning_are_disjoint() -> None:
    """Those of a run are hashed to 63 bits, beyond all that is written by hand."""
    found: dict[str, set[int]] = defaultdict(set)
    for seed, purpose in itertools.product((1, 2, 3, 4, 5), (*TRAINING, SELECTION)):
        found[purpose] |= {
            random_streams.derived_seed(seed, purpose, *index)
            for index in (*((first,) for first in range(300)),
                          *itertools.product(range(300), range(1, 4)))}
    for one, other in itertools.combinations(found.values(), 2):
        assert not one & other
    by_hand = {*EVALUATIONS, *range(tuning.FIRST_SEED, tuning.LAST_SEED + 1), 0, 1}
    assert max(by_hand) < 2**31 < min(map(min, found.values()))
    assert min(EVALUATIONS) > tuning.LAST_SEED


class Watched:
    """A fleet of one world that records each reset: its seed, and the first observation."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Make the world."""
        self.world = worlds.make('rocket', 8)
        self.stage = ''
        self.resets: dict[str, list[tuple[int, NDArray[Any]]]] = defaultdict(list)
        reset = self.world.reset

        def watch(seed: int | None = None, **settings: Any) -> NDArray[Any]:
            observation = reset(seed, **settings)
            assert seed is not None
            self.resets[self.stage].append((seed, observation.copy()))
            return observation

        monkeypatch.setattr(self.world, 'reset', watch)

    def report(self, status: Status) -> None:
        """Take note of the stage."""
        self.stage = status.stage


@pytest.mark.slow
def test_a_run_is_selected_and_evaluated_on_starts_that_it_did_not_train_on(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the seeds that its world was reset with, and by the starts that came of them."""
    watched = Watched(monkeypatch)
    spec, seed = watched.world.spec, int(str(SMALL['seed']))
    config = load_preset('default', 'rocket', **{**SMALL, 'hidden_sizes': (16, 16)})
    Trainer(SerialFleet(watched.world), config, RunFolder(tmp_path / 'run'),
            watched.report).run()
    watched.stage = 'evaluate'
    evaluate(watched.world, RandomPilot(spec, 1), 8, config.run.evaluation_seed, level=7)
    rehearsed, = {first for first, _ in watched.resets.pop('')}
    assert rehearsed == 0
    asked = {stage: {first for first, _ in resets} for stage, resets in watched.resets.items()}
    selecting = {random_streams.derived_seed(seed, SELECTION, wave) for wave in range(4)}
    flown = {
        'training': asked['demonstrate'] | asked['clone'] | (asked['finetune'] - selecting),
        'selection': asked['finetune'] & selecting, 'evaluation': asked['evaluate']}
    assert flown['evaluation'] == {config.run.evaluation_seed}
    assert len(flown['training']) > 3 and flown['selection']
    starts = {
        kind: np.concatenate([
            observation for resets in watched.resets.values()
            for first, observation in resets if first in chosen])
        for kind, chosen in flown.items()}
    for one, other in itertools.combinations(flown, 2):
        assert not flown[one] & flown[other]
        assert not _rows(starts[one]) & _rows(starts[other])


def _rows(starts: Sequence[NDArray[Any]] | NDArray[Any]) -> set[bytes]:
    return {start.tobytes() for start in starts}


def test_the_benchmark_of_seeds_puts_its_rows_into_a_table(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """Also for a pilot that lands nothing, which has no fuel or touchdown figures."""
    monkeypatch.setattr(bench_seeds, 'ROCKETS', 8)
    options = argparse.Namespace(world='rocket', episodes=8, seed=77)
    task = 'mix:7'
    flown = [
        {'pilot': name, 'task': task, **bench_seeds.figures(bench_seeds.fly(options, name, task))}
        for name in ('random', 'robust')]
    crashed, landed = flown
    assert (crashed['landed'], crashed['fuel_ratio'], crashed['touchdown_speed_p95']) == (
        0, None, None)
    assert bench_seeds.row('random', task, crashed).startswith('random           mix:7')
    assert '  fuel 1.' in bench_seeds.row('robust', task, landed)
    head, _, first, second = bench_seeds.markdown(flown).splitlines()
    assert [cell.strip() for cell in head.split('|')][1:4] == [
        'pilot', 'mix, level 7: landed', 'mean return']
    assert first.split('|')[2].strip() == '0.00 %'
    assert second.split('|')[2].strip() == f'{100 * landed["landed"] / 8:.2f} %'
    assert f'{landed["mean_return"]:.2f} [' in second
    json.dumps(flown, allow_nan=False)
