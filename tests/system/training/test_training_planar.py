# SPDX-License-Identifier: Apache-2.0
"""Training in the worlds with contact: over DDS, across kills, the same as in process."""
from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import pytest
from support.processes import Processes
from support.training.training_runs import agent
from support.training.training_runs import assert_same_run
from support.training.training_runs import simulator
from support.training.training_runs import train_in_process

from rocket_sim_node.recording.reader import trajectories

SETTINGS: dict[str, dict[str, Any]] = {
    # Long enough for landers to crash, to lie about and to begin anew.
    'lunar_lander': {
        'demonstration_episodes': 0, 'n_steps': 100, 'critic_warmup_iterations': 0,
        'curriculum_start_level': 0, 'curriculum_final_level': 0, 'curriculum_wide_level': 0},
    'rocket_planar': {'demonstration_episodes': 8, 'n_steps': 100},
}


@pytest.mark.parametrize('world', ['lunar_lander', 'rocket_planar'])
def test_training_over_dds_and_kills_equals_training_in_process(
        world: str, request: pytest.FixtureRequest, processes: Processes,
        tmp_path: Path) -> None:
    if world == 'lunar_lander':
        request.getfixturevalue('nightly_only')
    settings = SETTINGS[world]
    undisturbed = train_in_process(tmp_path / 'undisturbed', world, **settings)
    run, recording = tmp_path / 'run', tmp_path / 'recording.rrd'
    recorder = processes.run_node('rocket_sim_node', 'rerun_recorder', output=recording)
    first = simulator(processes, world)
    trainer = agent(processes, run, **settings)
    trainer.wait_for('PPO 1/', 90.0)
    first.signal(signal.SIGKILL)
    first.wait(5.0)
    simulator(processes, world)
    trainer.wait_for('PPO 2/', 60.0)
    trainer.signal(signal.SIGKILL)
    trainer.wait(5.0)
    resumed = agent(processes, run, resume=True, plots=True, **settings)
    assert resumed.wait(120.0) == 0, processes.logs()
    assert_same_run(run, undisturbed)
    evaluation = json.loads((run / 'evaluation.json').read_text())
    assert evaluation['world'] == world
    assert evaluation['episodes'] == sum(evaluation['outcomes'].values()) == 20
    assert (evaluation['standing_rate'] is None) == (world == 'lunar_lander')
    assert len(list((run / 'plots').glob('*.png'))) >= 3
    recorder.signal(signal.SIGINT)
    assert recorder.wait(20.0) == 0, processes.logs()
    flights = trajectories(recording)
    assert flights
    assert max(len(flight.time) for flight in flights) > 50
