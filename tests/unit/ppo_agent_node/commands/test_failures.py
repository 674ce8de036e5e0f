# SPDX-License-Identifier: Apache-2.0
"""Failures of an evaluation, flown again: the same flights, in a recording."""
from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ppo_agent_node.commands.failures import Failures
from ppo_agent_node.commands.failures import fly_again
from ppo_agent_node.commands.failures import make
from ppo_agent_node.evaluation.metrics import summarise
from ppo_agent_node.evaluation.metrics import write_json
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.choice import choose
from ppo_agent_node.pilots.expert.expert import ExpertPilot
from ppo_agent_node.pilots.random import RandomPilot
from rocket_sim_node import worlds
from rocket_sim_node.recording.reader import trajectories


def test_the_flights_are_those_of_the_evaluation(tmp_path: Path) -> None:
    world = worlds.make('rocket', 5, spawn_height=30.0, observation='extended')
    result = evaluate(world, RandomPilot(world.spec, 7), 10, 7, level=8, conditions='mix')
    summary = summarise(result)
    write_json(tmp_path / 'evaluation.json', summary)
    said = make(Failures(run_dir=str(tmp_path)))
    assert f'failures: {tmp_path / "failures.rrd"}' in said
    assert said.count('rocket ') == len(summary['failed_starts']) == 10
    assert len(trajectories(tmp_path / 'failures.rrd')) == 10
    # The last samples are where the evaluation says that they ended.
    starts = [(one['row'], one['episode']) for one in summary['failed_starts']]
    again = worlds.make('rocket', 5, **worlds.settings_from('rocket', summary['world_settings']))
    flown = fly_again(again, RandomPilot(again.spec, 7), 7, starts)
    ended = flown.outcome != 255
    assert int(ended.sum()) == 10
    place = {(row, episode): number for number, (row, episode) in enumerate(
        zip(result.episodes.row.tolist(), result.episodes.episode.tolist(), strict=True))}
    for row, episode, outcome in zip(
            flown.row[ended].tolist(), flown.episode[ended].tolist(),
            flown.outcome[ended].tolist(), strict=True):
        number = place[row, episode]
        assert outcome == result.episodes.outcome[number]
        mine = (flown.row == row) & (flown.episode == episode)
        assert np.count_nonzero(mine) == result.episodes.length[number] + 1


@pytest.mark.slow
@pytest.mark.parametrize('tuned', [False, True])
def test_failures_are_flown_by_the_pilot_of_the_evaluation(tmp_path: Path, tuned: bool) -> None:
    """The estimator, and gains of a file: the default expert would fly differently."""
    world = worlds.make('rocket', 4, spawn_height=40.0)
    name = 'expert_estimator'
    if tuned:
        name = str(tmp_path / 'gains.json')
        Path(name).write_text(json.dumps({'pilot': 'expert', 'gains': {'flare_rate': 3.0}}))
    chosen = choose(name, world.spec)
    result = evaluate(world, chosen.pilot, 4, 7, level=8, conditions='harsh')
    summary = summarise(result, **chosen.facts)
    write_json(tmp_path / 'evaluation.json', summary)
    make(Failures(run_dir=str(tmp_path)))
    flights = trajectories(tmp_path / 'failures.rrd')
    lengths = dict(zip(result.episodes.row.tolist(), result.episodes.length.tolist(), strict=True))
    assert len(flights) == len(summary['failed_starts']) > 0
    for one in flights:
        assert one.time[-1] == pytest.approx(lengths[one.row] * world.spec.dt, abs=1e-3)


def test_nothing_is_recorded_when_all_episodes_landed(tmp_path: Path) -> None:
    world = worlds.make('rocket', 2, spawn_height=30.0)
    write_json(tmp_path / 'evaluation.json', summarise(
        evaluate(world, ExpertPilot(world.spec), 2, 1, level=1)))
    assert 'all episodes landed' in make(Failures(run_dir=str(tmp_path)))
    assert not (tmp_path / 'failures.rrd').exists()


def test_evaluations_that_cannot_be_flown_again_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match='run_dir: got none'):
        make(Failures())
    with pytest.raises(FileNotFoundError):
        make(Failures(run_dir=str(tmp_path)))
    (tmp_path / 'evaluation.json').write_text('{}')
    with pytest.raises(ValueError, match=r"evaluation.json: damaged, or .*'failed_starts'"):
        make(Failures(run_dir=str(tmp_path)))
    world = worlds.make('rocket', 2, spawn_height=20.0)
    summary = summarise(evaluate(world, RandomPilot(world.spec), 2, 1, level=8))
    shipped = Path(__file__).parents[4] / (
        'ppo_agent_node/ppo_agent_node/policies/rocket.safetensors')
    changed = {**summary, 'policy': 'policy', 'policy_file': str(shipped), 'policy_sha256': '0'}
    (tmp_path / 'evaluation.json').write_text(json.dumps(changed))
    with pytest.raises(ValueError, match='is not the policy that was evaluated'):
        make(Failures(run_dir=str(tmp_path)))
