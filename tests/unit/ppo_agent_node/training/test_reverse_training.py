# SPDX-License-Identifier: Apache-2.0
"""Training runs by the reverse curriculum: heights grow, and an interrupted run ends alike."""
from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from support.invalid_data.forged_files import contents
from support.invalid_data.forged_files import packed
from support.training.training_runs import left_by
from support.training.training_runs import log_without_times

from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.config.training_config import check_world
from ppo_agent_node.config.training_config import make_config
from ppo_agent_node.runs import tensor_file
from ppo_agent_node.runs.folder import CHECKPOINT
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.training.stop_criterion import Result
from ppo_agent_node.training.trainer import Trainer
from rocket_sim_node import worlds
from rocket_sim_node.telemetry.training_status import Status
from rocket_sim_node.worlds.jobs import SerialFleet

SETTINGS: dict[str, Any] = {
    'demonstration_episodes': 0, 'hidden_sizes': (16, 16), 'iterations': 12, 'n_steps': 40,
    'scatter_steps': 60, 'batch_size': 64, 'critic_warmup_iterations': 0, 'threads': 1,
    'checkpoint_interval': 3, 'selection_interval': 4, 'selection_episodes': 8,
    'selection_from_landing_rate': 0.01, 'curriculum_start_level': 7, 'curriculum_final_level': 8,
    'curriculum_start_reach': 0.2, 'curriculum_reach_growth': 1.5,
    'curriculum_landing_rate': 0.0, 'curriculum_window': 4,
    'curriculum_reach_landing_rate': 0.0, 'actor_learning_rate': 1e-3, 'num_groups': 2}


def train(
    path: Path, stop: Callable[[], bool] = lambda: False, statuses: list[Status] | None = None,
    resume: bool = False, height: float = 6.0, **changes: Any,
) -> Result:
    env = worlds.make('rocket', num_envs=8, seed=3, level=7, spawn_height=height, time_limit=6.0)
    config = make_config({**SETTINGS, **changes})
    return Trainer(
        SerialFleet(env), config, RunFolder(path, resume),
        (statuses if statuses is not None else []).append, stop_requested=stop).run()


@pytest.fixture(scope='module')
def straight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run that nothing disturbed, in which the reach grows to the end."""
    path = tmp_path_factory.mktemp('runs') / 'run'
    statuses: list[Status] = []
    assert train(path, statuses=statuses).finished
    found = log_without_times(path)
    reaches = [line['reach'] for line in found]
    assert [s.reach for s in statuses if s.is_iteration] == reaches
    assert sorted(set(reaches)) == pytest.approx([0.2, 0.3, 0.45, 0.675, 0.8])
    assert reaches == sorted(reaches)
    messages = [line.get('message', '') for line in found]
    assert messages[1] == 'reach 0.20 -> 0.30 m'  # a fall from 0.2 m lands, at 2 m/s
    over = next(k for k, text in enumerate(messages) if text.startswith('the whole task, level 7'))
    assert reaches[over] == pytest.approx(0.8)
    # Only then levels count.
    levels = [line['level'] for line in found]
    assert set(levels[:over + 1]) == {7} and levels[-1] == 8
    selections = [line['iteration'] for line in found if 'selection_return' in line]
    # At 4 the window is not full. After 8 it is empty, as the task has just become harder.
    assert messages[8].startswith(('reach', 'the whole task', 'level'))
    assert selections == [8, 12]
    return path


def test_the_heights_of_starts_follow_the_curriculum(straight: Path) -> None:
    """Free fall from h takes sqrt(2 h / g) / dt steps; with braking it takes longer."""
    for line in log_without_times(straight)[1:5]:
        longest = (2 * line['reach'] / 9.81)**0.5 / 0.02
        assert 0.5 * longest < line['mean_length'] < 2.5 * longest


@pytest.mark.parametrize('polls', [140, 300, 620])
def test_a_run_stopped_anywhere_and_resumed_ends_the_same(
    straight: Path, tmp_path: Path, polls: int,
) -> None:
    path, left = tmp_path / 'run', [polls]

    def stop() -> bool:
        left[0] -= 1
        return left[0] < 0

    assert not train(path, stop).finished
    assert train(path, resume=True).finished
    assert left_by(path) == left_by(straight)


def test_a_reach_that_no_world_has_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r'curriculum_start_reach: got 1, .* 0\.8 m'):
        train(tmp_path / 'run', curriculum_start_reach=1.0)
    lander = {'curriculum_start_level': 0, 'curriculum_final_level': 0,
              'demonstration_episodes': 0}
    env = worlds.make('lunar_lander', num_envs=2)
    config = make_config({'curriculum_start_reach': 9.5, **lander})
    with pytest.raises(ValueError, match=r'curriculum_start_reach: got 9\.5, .* 9\.43333 m'):
        Trainer(SerialFleet(env), config, RunFolder(tmp_path / 'run', False))
    settings = {name: value for name, value in env.spec.settings.items() if name != 'spawn_reach'}
    with pytest.raises(ValueError, match=r"curriculum_start_reach: .*'lunar_lander' has no"):
        check_world(make_config({'curriculum_start_reach': 1.0, **lander}),
                    replace(env.spec, settings=settings))


def test_a_run_from_before_the_starts_near_the_ground_is_resumed(tmp_path: Path) -> None:
    """A lander's run does not need to know the newer setting of its world."""
    def learn(folder: str, polls: int, resume: bool = False) -> bool:
        left = iter(range(polls))
        config = load_preset(
            'from_scratch', 'lunar_lander', iterations=3, n_steps=8, batch_size=16, threads=1,
            curriculum_start_reach=0.0, selection_interval=3, selection_episodes=2,
            target_return=1e9)
        return Trainer(
            SerialFleet(worlds.make('lunar_lander', num_envs=2)), config,
            RunFolder(tmp_path / folder / 'run', resume),
            stop_requested=lambda: next(left, None) is None).run().finished

    for folder in ('straight', 'older'):
        (tmp_path / folder).mkdir()
    assert learn('straight', sys.maxsize)
    assert not learn('older', 30)
    checkpoint = max((tmp_path / 'older' / 'run' / 'checkpoints').iterdir())
    tensors, content = tensor_file.read(checkpoint, CHECKPOINT)
    del content['description']['world_settings']['spawn_reach']
    arrays = contents(tensors['world'].numpy().tobytes())
    del arrays['spawn_reach']
    tensors['world'] = torch.from_numpy(np.frombuffer(packed(arrays), np.uint8).copy())
    tensor_file.write(checkpoint, CHECKPOINT, tensors, content)
    assert learn('older', sys.maxsize, resume=True)
    assert left_by(tmp_path / 'older' / 'run') == left_by(tmp_path / 'straight' / 'run')


@pytest.mark.slow
def test_the_reach_grows_when_the_policy_learns_to_land(tmp_path: Path) -> None:
    """A fall from 0.46 m is too fast: only a policy that brakes lands from 0.8 of 1 m."""
    statuses: list[Status] = []
    train(tmp_path / 'run', statuses=statuses, curriculum_start_reach=0.3, n_steps=128,
          iterations=20, curriculum_final_level=7, curriculum_window=16, batch_size=256,
          curriculum_reach_landing_rate=0.8, height=20.0, log_std_init=-0.7,
          log_std_final=-1.0, gamma=0.999, critic_learning_rate=2e-3)
    assert 0.8 * max(s.reach for s in statuses if s.is_iteration) > (3.0**2 / (2 * 9.81))
