# SPDX-License-Identifier: Apache-2.0
"""The tables of telemetry: messages, captures and recordings follow from them."""
from __future__ import annotations

import os
import runpy
import shutil
import subprocess
import sys
from dataclasses import asdict
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rocket_msgs.msg import RocketState
from rocket_msgs.msg import TrainingStatus
from support.recording.recordings import fly
from support.recording.recordings import lines_of
from support.recording.recordings import record
from support.recording.recordings import rows_of

from ppo_agent_node.nodes.agent.status_message import status_from_message
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.runs.metrics_logger import MetricsLogger
from rocket_sim_node import worlds
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.drawing.training_plots import training_of
from rocket_sim_node.recording.recorder import Recorder
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.telemetry.quantities import NO_OUTCOME
from rocket_sim_node.telemetry.quantities import QUANTITIES
from rocket_sim_node.telemetry.samples import samples_of
from rocket_sim_node.telemetry.training_status import Status
from rocket_sim_node.wire.messages import conversion

ROOT = Path(__file__).parents[4]
MESSAGES = ROOT / 'rocket_msgs' / 'make_messages.py'
ADDED = (
    ('quantities.py', "    Quantity('reward'", """\
    Quantity('gust', 'm/s^2, of gusts', 'gust', 2, curves=Curves(
        'gust', 'Gusts', {'x': palette.SKY, 'z': palette.ORANGE})),
"""),
    ('training_status.py', '    value_loss:', """\
    gradient: float = _number('norm', Curve('loss', 'gradient', palette.GREY))
"""),
)
"""Additions of the test: the file of a table, the row that follows the new one, the new row."""


def texts() -> dict[str, str]:
    """Return the messages' texts, as made from the tables."""
    made: dict[Path, str] = runpy.run_path(str(MESSAGES))['texts']()
    return {path.name: text for path, text in made.items()}


def test_the_messages_are_current() -> None:
    for name, text in texts().items():
        assert (MESSAGES.parent / 'msg' / name).read_text() == text, (
            'run: python rocket_msgs/make_messages.py')


def test_the_messages_as_built_have_the_fields_of_the_tables() -> None:
    state = RocketState.get_fields_and_field_types()
    assert list(state) == ['header', 'session', 'step', *(one.name for one in QUANTITIES)]
    assert list(TrainingStatus.get_fields_and_field_types()) == [
        'header', *(one.name for one in fields(Status))]
    assert RocketState.NONE == NO_OUTCOME


def test_every_source_is_an_attribute_of_a_world() -> None:
    """A misspelt source would leave the quantity 0 in all worlds."""
    taken = {name for world in worlds.names() for name in worlds.make(world)._layout[2]}
    assert {one.name for one in QUANTITIES if one.source} <= taken


@pytest.mark.slow
def test_a_row_is_all_that_a_new_quantity_needs(tmp_path: Path) -> None:
    """In a copy of the package with one row more in each table."""
    package = ROOT / 'rocket_sim_node' / 'rocket_sim_node'
    copy = tmp_path / package.name
    shutil.copytree(package / 'telemetry', copy / 'telemetry')
    for path in package.iterdir():
        if path.name != 'telemetry':
            (copy / path.name).symlink_to(path)
    for name, before, row in ADDED:
        path = copy / 'telemetry' / name
        text = path.read_text()
        assert text.count(before) == 1
        path.write_text(text.replace(before, row + before))
    paths = os.pathsep.join((str(tmp_path), str(ROOT / 'tests'), *sys.path))
    done = subprocess.run(
        [sys.executable, __file__, str(tmp_path)], text=True, capture_output=True, timeout=120.0,
        env={**os.environ, 'PYTHONPATH': paths}, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def check_quantity(folder: Path) -> None:
    """Check that a world's gusts are in telemetry, message and recording."""
    assert 'float64[] gust              # S x 2, m/s^2, of gusts\n' in texts()['RocketState.msg']
    world, samples = fly(
        'rocket', 4, 30, lambda state, _: np.zeros((len(state.gust), 3), np.float32),
        gust_deviation=1.0)
    telemetry = world.telemetry(slice(None))
    np.testing.assert_array_equal(telemetry.gust, world.gust.T)  # type: ignore[attr-defined]
    assert np.all(telemetry.gust != 0.0)
    # The message as built lacks the field.
    conversion.RocketState = SimpleNamespace  # type: ignore[misc,assignment]
    message: Any = conversion.state_to_message(np.zeros(4, np.uint64), telemetry, 1)
    received = samples_of(message)
    np.testing.assert_array_equal(
        received.values[:, received.layout.place('gust')], telemetry.gust)
    assert not worlds.make('lunar_lander', 2).telemetry(slice(None)).gust.any()
    spec = world.spec
    record(folder / 'gusts.rrd', WorldInfo.build(
        spec.name, spec.dt, spec.outcomes, spec.settings, spec.condition_names), samples)
    drawn = np.array([row for _, row in lines_of(folder / 'gusts.rrd', entities.ROCKET, 'gust')])
    flown = samples.values[samples.row == 0][:, samples.layout.place('gust')]
    np.testing.assert_allclose(drawn[:-1], flown, rtol=1e-3)


class Trained(Recorder):
    """Records a report before it is closed."""

    report: Any = None

    def close(self) -> None:
        """Record the report."""
        self.training(training_of(self.report))
        super().close()


def check_status(folder: Path) -> None:
    """Check that a value of the trainer is in log, message, display and recording."""
    assert 'float64 gradient            # norm\n' in texts()['TrainingStatus.msg']
    statuses: list[Status] = []
    logger = MetricsLogger(RunFolder(folder / 'run'), statuses.append)
    logger.begin('finetune', 9)
    logger.entry(1, 100, policy_loss=1.0, gradient=2.0, value_loss=3.0)
    Trained.report = SimpleNamespace(**asdict(statuses[-1]))
    assert status_from_message(Trained.report) == statuses[-1]
    world, samples = fly(
        'rocket', 1, 30, lambda state, _: np.zeros((len(state.row), 3), np.float32))
    spec = world.spec
    record(folder / 'training.rrd', WorldInfo.build(
        spec.name, spec.dt, spec.outcomes, spec.settings), samples, kind=Trained)
    (_, values), = rows_of(
        folder / 'training.rrd', f'{entities.TRAINING}/loss', 'Scalars:scalars', 'iteration')
    assert values == [1.0, 2.0, 3.0]


if __name__ == '__main__':
    check_quantity(Path(sys.argv[1]))
    check_status(Path(sys.argv[1]))
