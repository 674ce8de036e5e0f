# SPDX-License-Identifier: Apache-2.0
"""Recordings of vector environments for Rerun."""
from __future__ import annotations

import gc
import re
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from rocket_sim_node.gym import IDS
from rocket_sim_node.gym import ReverseCurriculum
from rocket_sim_node.gym.record_rerun import RecordRerun
from rocket_sim_node.recording.reader import trajectories

N = 4
LOW = {'spawn_reach': 5.0}


def make(name: str = 'hoverslam/Rocket-v1', **keywords: Any) -> Any:
    low = {} if 'Lander' in name else LOW
    return gymnasium.make_vec(name, **{'num_envs': N, 'seed': 1, **low, **keywords})


@pytest.mark.parametrize('mode', ['SAME_STEP', 'NEXT_STEP'])
@pytest.mark.parametrize('name', IDS.values())
def test_the_flights_are_those_of_the_environment(name: str, mode: str, tmp_path: Path) -> None:
    path = tmp_path / 'flights.rrd'
    envs = RecordRerun(make(name, autoreset_mode=mode), path, rows=[1, 3])
    envs.reset()
    envs.action_space.seed(3)
    ended = []
    for _ in range(400):
        _, _, terminated, truncated, info = envs.step(envs.action_space.sample())
        figures = info.get('final_info', info)
        ended += [(row, float(figures['episode_return'][row]))
                  for row in (1, 3) if (terminated | truncated)[row]]
    assert envs.path is None
    envs.close()
    envs.close()
    assert envs.path == path
    recorded = [(flight.row, flight.summary['return']) for flight in trajectories(path)]
    assert ended and [row for row, _ in recorded] == [row for row, _ in ended]
    if mode == 'SAME_STEP':  # with NEXT_STEP, the statistics leave out a step
        np.testing.assert_allclose([x for _, x in recorded], [x for _, x in ended], rtol=1e-4)


def test_resets_of_a_curriculum_end_the_flights_in_progress(tmp_path: Path) -> None:
    recorder = RecordRerun(
        gymnasium.make_vec('hoverslam/Rocket-v1', num_envs=N, seed=1), tmp_path / 'flights.rrd',
        rows=range(N))
    envs = ReverseCurriculum(recorder, window=N, landing_rate=0.9)
    envs.reset()
    idle = np.tile(np.float32([-1, 0, 0]), (N, 1))  # from so low, falling is landing
    ended = 0
    for _ in range(60):
        info = envs.step(idle)[4]
        ended += int(info['_final_info'].sum()) if info else 0
    envs.close()
    assert envs.reach > 0.4
    flights = trajectories(tmp_path / 'flights.rrd')
    assert len(flights) == recorder.flights == ended
    for flight in flights:
        assert (np.diff(flight.position[:, 2]) <= 0).all()  # none goes on after a reset
    with pytest.raises(ValueError, match='expected no ReverseCurriculum inside, but around'):
        RecordRerun(ReverseCurriculum(make(spawn_reach=0.0)), 'flights.rrd')


def test_without_close_the_file_is_completed_as_well(tmp_path: Path) -> None:
    envs = RecordRerun(make(), tmp_path / 'flights.rrd')
    envs.reset()
    idle = np.tile(np.float32([-1, 0, 0]), (N, 1))
    while not envs.flights:
        envs.step(idle)
    del envs
    gc.collect()
    assert [file.name for file in tmp_path.iterdir()] == ['flights.rrd']
    assert trajectories(tmp_path / 'flights.rrd')


def test_a_name_that_is_taken_is_numbered(tmp_path: Path) -> None:
    written = []
    for _ in range(2):
        envs = RecordRerun(make(), tmp_path / 'twice.rrd')
        envs.reset()
        while not envs.flights:
            envs.step(np.tile(np.float32([-1, 0, 0]), (N, 1)))
        envs.close()
        written.append(envs.path)
    assert written == [tmp_path / 'twice.rrd', tmp_path / 'twice-2.rrd']
    assert all(path.exists() for path in written)


def test_warnings_show_a_path_as_it_is(tmp_path: Path) -> None:
    envs = RecordRerun(make(), tmp_path / '100%s.rrd')
    with pytest.warns(UserWarning, match='nothing was recorded: .*100%s.rrd was not written'):
        envs.close()
    assert envs.path is None


@pytest.mark.parametrize(('keywords', 'message'), [
    ({'output': 3}, 'output: got 3, expected the name of a file'),
    ({'output': True}, 'output: got True, expected the name of a file'),
    ({'connect': 3}, 'connect: got 3, expected a URL'),
])
def test_destinations_of_a_wrong_type_are_named(keywords: dict[str, Any], message: str) -> None:
    with pytest.raises(TypeError, match=message):
        RecordRerun(make(), **keywords)


def test_a_wrong_viewer_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="connect: got 'garbage'"):
        RecordRerun(make(), tmp_path / 'flights.rrd', connect='garbage')
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(('keywords', 'message'), [
    ({}, "output: got '', expected a file, or a URL in connect"),
    ({'output': 'a.rrd', 'rows': [N]}, f'rows: got ({N},), expected numbers from 0 to {N - 1}'),
    ({'output': 'a.rrd', 'rows': []}, 'rows: got (), expected numbers'),
    ({'output': 'a.html'}, "output: got 'a.html', expected a name that ends with .rrd"),
    ({'output': 'a.rrd', 'max_steps': -1}, 'max_steps: got -1, expected 0 to'),
])
def test_bad_keywords_are_named(
    keywords: dict[str, Any], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=re.escape(message)):
        RecordRerun(make(), **keywords)
    with pytest.raises(TypeError, match='rows: got 0, expected a list of whole numbers'):
        RecordRerun(make(), 'a.rrd', rows=0)
    assert not list(tmp_path.iterdir())


def test_only_our_environments_in_this_process_are_recorded() -> None:
    for other in gymnasium.make('hoverslam/Rocket-v1'), None:
        with pytest.raises(ValueError, match='expected a HoverslamVectorEnv in this process'):
            RecordRerun(other, 'flights.rrd')
