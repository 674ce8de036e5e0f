# SPDX-License-Identifier: Apache-2.0
"""Loggers beside train.jsonl: they get each line once, and their failures end no run."""
from __future__ import annotations

import importlib
import json
from collections import Counter
from collections.abc import Callable
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from ppo_agent_node.commands.arguments import parse
from ppo_agent_node.config.training_config import make_config
from ppo_agent_node.runs import loggers
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.runs.loggers import MakeLogger
from ppo_agent_node.training.trainer import Trainer
from rocket_sim_node import worlds
from rocket_sim_node.telemetry.training_status import Status
from rocket_sim_node.worlds.jobs import SerialFleet

ROOT = Path(__file__).parents[4]
SMALL = {
    'demonstration_episodes': 4, 'clone_epochs': 1, 'dagger_rounds': 0, 'teacher_flare_rate': 3.0,
    'teacher_braking_share': 0.8, 'teacher_flare_speed': 0.1, 'demonstration_noise': 0.05,
    'hidden_sizes': (8,), 'iterations': 4, 'n_steps': 16, 'batch_size': 64, 'scatter_steps': 16,
    'critic_warmup_iterations': 1, 'threads': 1, 'checkpoint_interval': 2,
    'selection_interval': 4, 'selection_episodes': 4}
MINE = """
from pathlib import Path
class Mine:
    def __init__(self, folder): self.file = folder / 'mine.txt'
    def begin(self, lines): self.file.write_text(''.join(f"{x['stage']}\\n" for x in lines))
    def entry(self, line): self.file.write_text(self.file.read_text() + f"{line['stage']}\\n")
    def close(self): pass
"""


class Killed(BaseException):
    """The end of a process, as far as it can be had within one."""


def train(
    path: Path, made: Sequence[MakeLogger], resume: bool = False,
    report: Callable[[Status], None] = lambda status: None,
) -> None:
    """Train for four iterations."""
    world = worlds.make('rocket', 4, 0, level=7, spawn_height=20.0, time_limit=5.0)
    Trainer(
        SerialFleet(world), make_config(SMALL), RunFolder(path, resume), report,
        loggers=made).run()


def killed(status: Status) -> None:
    """End in the third iteration of four, after the checkpoint of the second."""
    if status.stage == 'finetune' and status.iteration == 3:
        raise Killed


def test_a_resumed_run_has_each_point_of_tensorboard_once(tmp_path: Path) -> None:
    accumulator = pytest.importorskip('tensorboard.backend.event_processing.event_accumulator')
    path, made = tmp_path / 'run', loggers.find('tensorboard')
    with pytest.raises(Killed):
        train(path, made, report=killed)
    # The third line had been logged; the run repeats it.
    assert [line['iteration'] for line in RunFolder(path, True).lines()][-1] == 3
    train(path, made, resume=True)
    events = list((path / 'tensorboard').glob('events.*'))
    assert len(events) == 1
    found = accumulator.EventAccumulator(
        str(events[0]), {'scalars': 0}, purge_orphaned_data=False).Reload()
    points = Counter(
        (tag, point.step) for tag in found.Tags()['scalars'] for point in found.Scalars(tag))
    assert set(points.values()) == {1}
    for line in RunFolder(path, True).lines():
        tag = f'{line["stage"]}/steps'
        assert {p.step: p.value for p in found.Scalars(tag)}[line['iteration']] == line['steps']
    losses = found.Scalars('finetune/value_loss')
    assert [point.step for point in losses] == [1, 2, 3, 4]
    times = [point.wall_time for point in losses]
    assert times == sorted(times)


def test_a_custom_logger_gets_the_lines_of_the_log(tmp_path: Path) -> None:
    file = tmp_path / 'my_logger.py'
    file.write_text(MINE)
    path, made = tmp_path / 'run', loggers.find(f' {file}:Mine ,')
    with pytest.raises(Killed):
        train(path, made, report=killed)
    train(path, made, resume=True)
    assert (path / 'mine.txt').read_text().split() == [
        line['stage'] for line in RunFolder(path, True).lines()]


def test_a_logger_that_fails_is_dropped_and_the_run_continues(tmp_path: Path) -> None:
    class Broken:
        closed = 0

        def __init__(self, folder: Path) -> None:
            pass

        def begin(self, lines: Sequence[Any]) -> None:
            pass

        def entry(self, line: Any) -> None:
            raise ConnectionError('no network')

        def close(self) -> None:
            Broken.closed += 1

    messages: list[str] = []
    train(tmp_path / 'run', [Broken], report=lambda status: messages.append(status.message))
    said = [message for message in messages if 'logger Broken failed' in message]
    assert len(said) == 1
    assert 'no network' in said[0]
    assert RunFolder(tmp_path / 'run', True).lines()[-1]['iteration'] == 4
    assert not Broken.closed


def test_a_logger_that_cannot_be_made_is_reported_and_the_run_continues(tmp_path: Path) -> None:
    class Broken:
        def __init__(self, folder: Path) -> None:
            raise ConnectionError('no network')

        def begin(self, lines: Sequence[Any]) -> None:
            pass

        entry = close = begin

    messages: list[str] = []
    train(tmp_path / 'run', [Broken], report=lambda status: messages.append(status.message))
    assert [message for message in messages if 'logger Broken cannot be made' in message]
    assert RunFolder(tmp_path / 'run', True).lines()[-1]['iteration'] == 4


def test_a_file_with_a_dataclass_can_be_a_logger(tmp_path: Path) -> None:
    file = tmp_path / 'json.py'  # like a module of Python's
    file.write_text(
        'from __future__ import annotations\nfrom dataclasses import dataclass\n'
        '@dataclass\nclass Mine:\n    folder: str\n'
        '    def begin(self, lines): pass\n    entry = close = begin\n')
    made, = loggers.find(f'{file}:Mine')
    assert made.__name__ == 'Mine'
    assert importlib.import_module('json') is json


@pytest.mark.parametrize(('name', 'reason'), [
    ('wandb', "got 'wandb', expected tensorboard, package.module:Class or file.py:Class"),
    ('no_such_module:Class', "'no_such_module:Class' cannot be imported"),
    ('missing.py:Class', "'missing.py:Class' cannot be imported"),
    ('json:JSONDecoder', "'json:JSONDecoder' has no method begin, entry, close")])
def test_an_invalid_logger_is_named(name: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        loggers.find(name)


def test_without_tensorboard_the_error_says_how_to_install_it(
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('importlib.util.find_spec', lambda name: None)
    with pytest.raises(ValueError, match=r"'tensorboard' is not installed, expected: pip install"):
        loggers.find('tensorboard')


def test_files_of_loggers_are_found_from_any_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir('/')
    found = parse('train', ROOT / 'ppo_agent_node' / 'launch' / 'train.launch.yaml', [
        'loggers:=tensorboard,mine.py:Mine,a.b:C'])
    assert found.launch['loggers'] == 'tensorboard,/mine.py:Mine,a.b:C'
