# SPDX-License-Identifier: Apache-2.0
"""The examples of the documents run at a small scale."""
from __future__ import annotations

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from support.training.rank_program import free_port
from support.training.rank_program import variables

from rocket_sim_node.gym import IDS

EXAMPLES = Path(__file__).parents[2] / 'docs' / 'examples'


@pytest.fixture(autouse=True)
def _threads() -> object:
    """Examples set the number of threads; put it back."""
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize('world', ['lunar_lander', 'rocket'])
def test_ppo_in_a_single_file_is_reproducible(world: str) -> None:
    example = runpy.run_path(str(EXAMPLES / 'single_file_ppo.py'))
    options = {'name': IDS[world], 'num_envs': 8, 'num_steps': 32, 'minibatches': 4}
    first = example['train'](example['Options'](**options, steps=256)).state_dict()
    again = example['train'](example['Options'](**options, steps=256)).state_dict()
    more = example['train'](example['Options'](**options, steps=512)).state_dict()
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not all(torch.equal(first[name], more[name]) for name in first)


def test_ppo_in_a_single_file_says_where_it_saves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / 'weights.pt'
    monkeypatch.setattr(sys, 'argv', [
        'single_file_ppo.py', '--num-envs', '4', '--num-steps', '8', '--steps', '32',
        '--minibatches', '2', '--output', str(path)])
    runpy.run_path(str(EXAMPLES / 'single_file_ppo.py'), run_name='__main__')
    assert capsys.readouterr().out.endswith(f'policy: {path}\n')
    assert 'log_deviation' in torch.load(path, weights_only=True)


@pytest.mark.parametrize(('example', 'beside'), [
    ('sb3_ppo', ['model.zip.vecnormalize.pkl']), ('sb3_sac', [])])
def test_examples_of_stable_baselines3_say_where_they_save(
    example: str, beside: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip('stable_baselines3')
    # `save` looks for OpenAI's package, and would find the folder of tests of that name.
    monkeypatch.setitem(sys.modules, 'gym', None)
    monkeypatch.setattr(sys, 'argv', [
        f'{example}.py', '--num-envs', '1', '--steps', '1', '--output', str(tmp_path / 'model')])
    runpy.run_path(str(EXAMPLES / f'{example}.py'), run_name='__main__')
    assert f'policy: {tmp_path}/model.zip' in capsys.readouterr().out
    assert sorted(file.name for file in tmp_path.iterdir()) == ['model.zip', *beside]


@pytest.mark.parametrize(('arguments', 'message'), [
    (['land_by_action.py'], 'usage: python .*land_by_action.py RECORDING'),
    (['train_ranks.py', 'run', 'quick'], ".*train_ranks.py: got 'quick', expected NAME=VALUE"),
])
def test_missing_arguments_are_named_in_one_line(arguments: list[str], message: str) -> None:
    if 'land' in arguments[0]:
        pytest.importorskip('rclpy')
    done = subprocess.run(
        [sys.executable, EXAMPLES / arguments[0], *arguments[1:]],
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)},
        capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert re.fullmatch(f'{message}\n', done.stderr), done.stderr


@pytest.mark.slow
def test_ppo_in_a_single_file_learns(capsys: pytest.CaptureFixture[str]) -> None:
    example = runpy.run_path(str(EXAMPLES / 'single_file_ppo.py'))
    example['train'](example['Options'](steps=24_576, num_envs=32))
    returns = [float(each) for each in re.findall('return (-?[0-9.]+),', capsys.readouterr().out)]
    assert len(returns) == 12
    # Landers first learn to come down slowly instead of crashing at speed.
    assert sum(returns[-4:]) / 4 > sum(returns[:4]) / 4 + 20


@pytest.mark.parametrize('world', ['lunar_lander', 'rocket'])
def test_ppo_of_stable_baselines3_runs(world: str) -> None:
    pytest.importorskip('stable_baselines3')
    example = runpy.run_path(str(EXAMPLES / 'sb3_ppo.py'))
    model = example['train'](
        name=IDS[world], curriculum=world == 'rocket', num_envs=4, steps=256, n_steps=64,
        batch_size=64, verbose=0)
    assert model.num_timesteps == 256
    normalised = model.get_vec_normalize_env()
    assert normalised is not None and normalised.gamma == model.gamma


@pytest.mark.parametrize('world', ['lunar_lander', 'rocket'])
def test_sac_of_stable_baselines3_runs(world: str) -> None:
    pytest.importorskip('stable_baselines3')
    example = runpy.run_path(str(EXAMPLES / 'sb3_sac.py'))
    model = example['train'](
        name=IDS[world], curriculum=world == 'rocket', num_envs=4, steps=128, learning_starts=64,
        batch_size=32, verbose=0)
    assert model.num_timesteps == 128


@pytest.mark.parametrize('world', ['lunar_lander', 'rocket'])
def test_ppo_of_rsl_rl_runs(world: str, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip('rsl_rl')
    example = runpy.run_path(str(EXAMPLES / 'rsl_rl_ppo.py'))
    runner = example['train'](
        name=IDS[world], curriculum=world == 'rocket', num_envs=8, steps=512, num_steps=32)
    assert runner.current_learning_iteration == 1


@pytest.mark.parametrize('world', ['lunar_lander', 'rocket'])
def test_ppo_of_torchrl_runs(world: str, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip('torchrl')
    example = runpy.run_path(str(EXAMPLES / 'torchrl_ppo.py'))
    example['train'](
        name=IDS[world], curriculum=world == 'rocket', num_envs=8, steps=512, num_steps=32,
        minibatches=4)
    assert '512 steps, return' in capsys.readouterr().out


def test_a_rank_that_waits_for_the_others_can_be_stopped(tmp_path: Path) -> None:
    with subprocess.Popen(
            [sys.executable, '-u', EXAMPLES / 'train_ranks.py', tmp_path / 'run'],
            env={**os.environ, **variables(0, 2, free_port()),
                 'PYTHONPATH': os.pathsep.join(sys.path)},
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as rank:
        assert rank.stdout is not None
        assert 'waiting for the others' in rank.stdout.readline()
        rank.terminate()
        said, _ = rank.communicate(timeout=20)
    assert rank.returncode == 0, said
    assert said == 'stopped before the training began\n'
    assert not (tmp_path / 'run').exists()


@pytest.mark.slow
def test_ranks_train_together(tmp_path: Path) -> None:
    run = tmp_path / 'run'
    done = subprocess.run(
        [sys.executable, '-m', 'torch.distributed.run', '--nproc-per-node', '2', '--master-addr',
         '127.0.0.1', '--master-port', str(free_port()), str(EXAMPLES / 'train_ranks.py'),
         str(run), 'num_groups=2', 'start_copies=1', 'n_steps=16', 'batch_size=4096',
         'iterations=1', 'demonstration_episodes=0', 'hidden_sizes=16',
         'selection_interval=1', 'selection_episodes=8', 'scatter_steps=0'],
        env={**os.environ, 'OMP_NUM_THREADS': '1', 'PYTHONPATH': os.pathsep.join(sys.path)},
        capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.endswith(f'policy: {run}/policy.safetensors\n'), done.stdout
    assert done.stdout.count('best policy so far') == 1
