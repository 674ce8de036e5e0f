# SPDX-License-Identifier: Apache-2.0
"""Training runs end alike, bit for bit: repeated, restarted, stopped and resumed."""
from __future__ import annotations

import dataclasses
import math
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from support.training.training_runs import GENTLE
from support.training.training_runs import left_by

from ppo_agent_node.config.training_config import Config
from ppo_agent_node.config.training_config import describe
from ppo_agent_node.config.training_config import make_config
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.ppo.rollout_buffer import in_order
from ppo_agent_node.runs import tensor_file
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.training import run_state
from ppo_agent_node.training.interruptible_fleet import InterruptibleFleet
from ppo_agent_node.training.stop_criterion import Result
from ppo_agent_node.training.trainer import Trainer
from rocket_sim_node import free_memory
from rocket_sim_node import worlds
from rocket_sim_node.telemetry.training_status import Status
from rocket_sim_node.worlds import EnvironmentRestarted
from rocket_sim_node.worlds import Episodes
from rocket_sim_node.worlds.jobs import SerialFleet

ROCKETS = 8


def small(**changes: Any) -> Config:
    return make_config({**GENTLE, **changes})


def world(seed: int = 0) -> worlds.VectorEnv:
    return worlds.make(
        'rocket', num_envs=ROCKETS, seed=seed, level=7, spawn_height=30.0, time_limit=6.0)


def train(
    path: Path, config: Config | None = None, env: Any = None, resume: bool = False,
    stop: Callable[[], bool] = lambda: False, statuses: list[Status] | None = None,
) -> Result:
    report = (statuses if statuses is not None else []).append
    return Trainer(
        SerialFleet(env or world()), config or small(), RunFolder(path, resume), report,
        stop_requested=stop).run()


@pytest.fixture(scope='module')
def straight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run that nothing disturbed."""
    path = tmp_path_factory.mktemp('runs') / 'run'
    statuses: list[Status] = []
    result = train(path, statuses=statuses)
    assert result.finished
    assert result.iterations == 6
    assert [s.stage for s in statuses if not s.message] and statuses[-1].iteration == 6
    assert {s.stage for s in statuses} == {'demonstrate', 'clone', 'finetune'}
    # A look before the first iteration says nothing of how long one takes.
    looked, *iterations = (s for s in statuses if s.stage == 'finetune' and s.is_iteration)
    assert looked.iteration == 0 and looked.remaining == math.inf
    assert all(math.isfinite(s.remaining) for s in iterations) and iterations[-1].remaining == 0.0
    # Policies are news, each in a line that stays; checkpoints, which may be thousands, are not.
    news = [s.message for s in statuses if s.message.startswith('saved')]
    assert news[0] == 'saved cloned.safetensors'
    assert all(text.startswith('saved policy.safetensors and ') for text in news[1:])
    assert statuses[-1].saved.endswith('checkpoints/iteration_000006.safetensors')
    assert [s.level for s in statuses if s.stage == 'finetune' and s.iteration][-1] == 3
    return path


def test_refused_starts_are_reported_before_the_run_is_written(tmp_path: Path) -> None:
    """Otherwise every resume would be refused as well."""
    for setting, value, whose in (
            ('demonstration_spawn_position', 500.0, 'demonstrations: .*spawn_position.* 500'),
            ('demonstration_spawn_angle', -0.5, 'demonstrations: .*spawn_angle')):
        with pytest.raises(ValueError, match=whose):
            train(tmp_path / setting, small(**{setting: value}))
        assert not (tmp_path / setting / 'config.yaml').exists()
        assert not (tmp_path / setting / 'train.jsonl').exists()


def test_a_rollout_larger_than_the_memory_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=(
            r'n_steps: got 1000000, which with 4096 groups \(num_groups\) of 8 rockets '
            r'\(num_envs\) takes [\d,]+ GiB to fly and learn from')):
        train(tmp_path / 'run', small(n_steps=1_000_000, num_groups=4096))


def copy_name(tmp_path: Path) -> Path:
    """Return a path for a run of the same name, which the policy file holds."""
    return tmp_path / 'run'


def test_files_of_a_run(straight: Path) -> None:
    assert sorted(p.name for p in straight.glob('[!.]*')) == [
        'checkpoints', 'cloned.safetensors', 'config.yaml', 'policy.safetensors', 'train.jsonl']
    checkpoints = sorted(p.name for p in (straight / 'checkpoints').iterdir())
    assert len(checkpoints) == 3
    assert checkpoints[0] == 'best.safetensors'
    assert checkpoints[2] == 'iteration_000006.safetensors'
    config = RunFolder(straight, resume=True).read_config()
    assert config['training']['seed'] == 1
    assert config['world_settings']['spawn_height'] == 30.0
    assert config['num_envs'] == ROCKETS
    assert make_config(config['training']) == small()
    env = world()
    observation = env.reset()
    for name, fact in (('policy', 'mean_return'), ('cloned', 'stage')):
        pilot = PolicyPilot(straight / f'{name}.safetensors', env.spec)
        assert np.isfinite(pilot(observation)).all()
        assert fact in pilot.description['training']


def test_the_earlier_state_of_the_world_does_not_change_a_run(
    straight: Path, tmp_path: Path,
) -> None:
    train(copy_name(tmp_path), env=world(seed=77))
    assert left_by(straight) == left_by(copy_name(tmp_path))


def test_another_seed_differs(straight: Path, tmp_path: Path) -> None:
    train(copy_name(tmp_path), small(seed=2, iterations=1, critic_warmup_iterations=0))
    policy = tensor_file.read(straight / 'policy.safetensors', 'policy').tensors
    other = tensor_file.read(copy_name(tmp_path) / 'policy.safetensors', 'policy').tensors
    assert not torch.equal(policy['mean.0.weight'], other['mean.0.weight'])


class StopAfter:
    """Requests a stop at the n-th poll."""

    def __init__(self, count: int) -> None:
        self.left = count

    def __call__(self) -> bool:
        self.left -= 1
        return self.left < 0


@pytest.mark.parametrize('polls', [20, 130, 420, 600, 700, 860])
def test_a_run_stopped_anywhere_and_resumed_ends_the_same(
    straight: Path, tmp_path: Path, polls: int,
) -> None:
    path = copy_name(tmp_path)
    assert not train(path, stop=StopAfter(polls)).finished
    assert train(path, env=world(seed=5), resume=True).finished
    assert left_by(straight) == left_by(path)


def test_a_killed_run_continues_from_its_last_checkpoint(
    straight: Path, tmp_path: Path,
) -> None:
    """Three iterations, everything thrown away but the files, three more."""

    class Killed(BaseException):
        pass

    path = copy_name(tmp_path)

    def kill(status: Status) -> None:
        if status.stage == 'finetune' and status.iteration == 5 and not status.message:
            raise Killed

    with pytest.raises(Killed):
        Trainer(SerialFleet(world()), small(), RunFolder(path), kill).run()
    with (path / 'train.jsonl').open('a') as log:
        log.write('{"stage": "finetune", "iter')
    statuses: list[Status] = []
    assert train(path, env=world(seed=5), resume=True, statuses=statuses).finished
    first = next(s for s in statuses if s.message)
    assert first.message.startswith('resumed from iteration_')
    assert first.stage == 'finetune'
    assert left_by(straight) == left_by(path)


def test_a_damaged_newest_checkpoint_costs_iterations_not_the_run(
    straight: Path, tmp_path: Path,
) -> None:
    path = copy_name(tmp_path)
    shutil.copytree(straight, path)
    newest = path / 'checkpoints' / 'iteration_000006.safetensors'
    newest.write_bytes(newest.read_bytes()[:1000])
    statuses: list[Status] = []
    assert train(path, resume=True, statuses=statuses).finished
    assert 'iteration_000006.safetensors: damaged' in statuses[0].message
    assert left_by(straight) == left_by(path)


@pytest.mark.parametrize(('ranks', 'change'), [
    (1, ''), (None, ''),
    (2, '; learners: 1 instead of 2, so the weights differ'),
    ('\x1b[2J', r"; learners: 1 instead of '\x1b[2J', so the weights differ"),
])
def test_another_number_of_learners_is_reported(
        straight: Path, tmp_path: Path, ranks: object, change: str) -> None:
    """Checkpoints of earlier versions do not contain it."""
    path = copy_name(tmp_path)
    shutil.copytree(straight, path)
    newest = path / 'checkpoints' / 'iteration_000006.safetensors'
    saved = tensor_file.read(newest, 'checkpoint')
    assert saved.content.pop('ranks') == 1
    tensor_file.write(newest, 'checkpoint', saved.tensors, {
        **saved.content, **({} if ranks is None else {'ranks': ranks})})
    statuses: list[Status] = []
    assert train(path, resume=True, statuses=statuses).finished
    assert f'resumed from {newest.name}{change}' in [status.message for status in statuses]


class Unreliable:
    """A world behind a simulator that dies now and then and comes back empty."""

    messages_dropped = 0

    def __init__(self, inner: Any, seed: int, rate: float) -> None:
        self._inner, self._random, self._rate = inner, random.Random(seed), rate
        self.spec, self.restarts = inner.spec, 0

    def __getattr__(self, name: str) -> Any:
        def call(*args: Any, **kwargs: Any) -> Any:
            before = self._random.random() < 0.5
            fails = self._random.random() < self._rate
            if not (fails and before):
                result = getattr(self._inner, name)(*args, **kwargs)
            if fails:
                self.restarts += 1
                self._inner.reset(seed=self._random.randrange(1000), level=1)
                raise EnvironmentRestarted('new session')
            return result

        return call


@pytest.mark.parametrize('seed', [1, 2])
def test_a_simulator_that_restarts_changes_nothing(
    straight: Path, tmp_path: Path, seed: int,
) -> None:
    env = Unreliable(world(), seed, rate=0.003)
    statuses: list[Status] = []
    assert train(copy_name(tmp_path), env=env, statuses=statuses).finished
    assert env.restarts >= 5
    assert sum('simulator restarted' in s.message for s in statuses) == env.restarts
    assert left_by(straight) == left_by(copy_name(tmp_path))


def test_a_simulator_that_always_restarts_ends_the_run(tmp_path: Path) -> None:
    with pytest.raises(EnvironmentRestarted):
        train(tmp_path / 'run', env=Unreliable(world(), 1, rate=1.0))


def learnt(statuses: list[Status], iteration: int) -> bool:
    """Return whether a run has reported that an iteration of fine-tuning is done."""
    return any(status.stage == 'finetune' and status.iteration == iteration for status in statuses)


@pytest.mark.parametrize('error', [TimeoutError, RuntimeError, ValueError])
def test_progress_before_the_loss_of_the_simulator_is_kept(
        straight: Path, tmp_path: Path, error: type[Exception]) -> None:
    path = copy_name(tmp_path)

    statuses: list[Status] = []

    def poll() -> bool:
        if learnt(statuses, 2):
            raise error('nobody answers')
        return False

    with pytest.raises(error, match='nobody answers'):
        train(path, stop=poll, statuses=statuses)
    assert sorted(file.name for file in (path / 'checkpoints').glob('iteration_*'))[-1] == (
        'iteration_000002.safetensors')
    assert train(path, env=world(seed=5), resume=True).finished
    assert left_by(straight) == left_by(path)


def test_an_older_run_continues_with_the_default_of_a_new_setting(
        straight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = copy_name(tmp_path)
    with monkeypatch.context() as patch:
        real = run_state.description

        def of_older_version(spec: Any, config: Config) -> dict[str, Any]:
            found = real(spec, config)
            del found['training']['value_clip_range']
            return found

        patch.setattr(run_state, 'description', of_older_version)
        statuses: list[Status] = []
        assert not train(path, statuses=statuses, stop=lambda: learnt(statuses, 2)).finished
    with pytest.raises(ValueError, match=r'value_clip_range of the run is 0\.0, expected 0\.2'):
        train(path, small(value_clip_range=0.2), resume=True)
    assert train(path, resume=True).finished
    assert left_by(straight) == left_by(path)


def test_an_older_run_without_a_setting_of_its_world_is_refused(
        straight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = copy_name(tmp_path)
    shutil.copytree(straight, path)
    real = run_state.description

    def of_newer_version(spec: Any, config: Config) -> dict[str, Any]:
        found = real(spec, config)
        return {**found, 'world_settings': {**found['world_settings'], 'moons': 2.0}}

    monkeypatch.setattr(run_state, 'description', of_newer_version)
    with pytest.raises(ValueError, match=(
            r'iteration_000006\.safetensors: the run has no moons, expected 2\.0; '
            r'the run is older than this setting of its world; start another run$')):
        train(path, resume=True)


def test_resuming_with_other_settings_is_refused(straight: Path, tmp_path: Path) -> None:
    path = copy_name(tmp_path)
    shutil.copytree(straight, path)
    with pytest.raises(ValueError, match=r'iteration_000006.*gamma of the run is 0\.9999'):
        train(path, small(gamma=0.9), resume=True)
    with pytest.raises(ValueError, match='num_envs of the run is 8, expected 4'):
        train(path, env=worlds.make('rocket', num_envs=4), resume=True)
    with pytest.raises(ValueError, match=r'spawn_height of the run is 30\.0'):
        train(path, env=worlds.make('rocket', num_envs=ROCKETS), resume=True)
    assert train(path, small(checkpoint_interval=1), resume=True).finished
    # Settings that may differ are written down: reports say what the evaluation was.
    found = RunFolder(path, resume=True).read_config()['training']
    assert (found['checkpoint_interval'], found['gamma']) == (1, 0.9999)


def test_episodes_of_all_groups_count_in_the_order_in_which_they_ended() -> None:
    def ended(step: int, *rows: int) -> tuple[int, Episodes]:
        every = {f.name: np.array(rows) for f in dataclasses.fields(Episodes)}
        return step, Episodes(**every)

    first, second = [ended(2, 0, 1), ended(5, 0)], [ended(1, 10), ended(2, 11), ended(9, 10)]
    assert in_order([first, second]).row.tolist() == [10, 0, 1, 11, 0, 10]
    assert len(in_order([[], []])) == 0


def test_checkpoints_with_other_shapes_are_refused(straight: Path, tmp_path: Path) -> None:
    path = copy_name(tmp_path)
    shutil.copytree(straight, path)
    newest = path / 'checkpoints' / 'iteration_000006.safetensors'
    tensors, content = tensor_file.read(newest, 'checkpoint')
    broken = {**tensors, 'critic.value.0.bias': torch.zeros(3)}
    tensor_file.write(newest, 'checkpoint', broken, content)
    with pytest.raises(ValueError, match=r"'critic\.value\.0\.bias' is .*\(3,\), expected .*16"):
        train(path, resume=True)
    for text, damage in (('its content is not', {'iteration': 'six'}), ('snapshot', {})):
        broken = {**tensors, 'world': tensors['world'][:50]}
        tensor_file.write(newest, 'checkpoint', broken, {**content, **damage})
        with pytest.raises(ValueError, match=f'iteration_000006.*{text}'):
            train(path, resume=True)


@pytest.mark.parametrize('threads', [1, 2])
def test_free_memory_is_returned_while_learning_and_not_in_flight(
    threads: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    given: list[tuple[str, int]] = []
    statuses: list[Status] = []
    flying = [False]
    fly = InterruptibleFleet.fly

    def flown(*arguments: Any) -> Any:
        flying[0] = True
        yield from fly(*arguments)
        flying[0] = False

    def give_back() -> None:
        assert not flying[0]
        given.append((statuses[-1].stage, statuses[-1].iteration))

    monkeypatch.setattr(InterruptibleFleet, 'fly', flown)
    monkeypatch.setattr(free_memory, 'PERIOD', 0.0)
    monkeypatch.setattr(free_memory, 'give_back', give_back)
    # A critic that learns alone in another thread may have done so before anyone looks.
    config = small(threads=threads, critic_warmup_iterations=0)
    assert train(tmp_path / 'run', config, statuses=statuses).finished
    assert {stage for stage, _ in given} == {'clone', 'finetune'}
    # Told before each update is the iteration before.
    iterations = {done for stage, done in given if stage == 'finetune'}
    assert iterations == set(range(GENTLE['iterations']))


def test_without_demonstrations_training_starts_from_scratch(tmp_path: Path) -> None:
    statuses: list[Status] = []
    config = small(demonstration_episodes=0, iterations=1, critic_warmup_iterations=0)
    assert train(tmp_path / 'run', config, statuses=statuses).finished
    assert {s.stage for s in statuses} == {'finetune'}
    assert not any('scores' in line for line in RunFolder(tmp_path / 'run', resume=True).lines())


def test_settings_are_checked_by_name() -> None:
    names = [info.name for info in describe()]
    assert len(names) == len(set(names))
    assert set(names) == set(make_config({}).flat())
    assert all(info.description for info in describe())
    for values, message in (
        ({'gama': 0.9}, "unknown setting 'gama'"), ({'gamma': 1.5}, 'gamma: got 1.5, expected 0'),
        ({'curriculum_start_level': 8}, 'curriculum_start_level: got 8'),
        ({'log_std_init': -6.0}, 'log_std_init: got -6.0'), ({'hidden_sizes': ()}, 'hidden_sizes'),
        ({'iterations': 5, 'critic_warmup_iterations': 5},
         'critic_warmup_iterations: got 5, expected less than iterations, 5'),
    ):
        with pytest.raises(ValueError, match=message):
            make_config(values)
