# SPDX-License-Identifier: Apache-2.0
"""Pilots by name: the expert that identifies its vehicle, and gains from a file."""
from __future__ import annotations

import json
from pathlib import Path

import pytest

from ppo_agent_node.pilots.choice import choose
from ppo_agent_node.pilots.estimator.estimator import ExpertEstimator
from ppo_agent_node.pilots.expert.expert import ExpertPilot
from rocket_sim_node import worlds


def test_the_expert_that_identifies_its_vehicle_has_a_name() -> None:
    spec = worlds.make('rocket').spec
    chosen = choose('expert_estimator', spec)
    assert isinstance(chosen.pilot, ExpertEstimator)
    assert chosen.label == 'expert_estimator'


def test_tuned_gains_are_flown_from_their_file(tmp_path: Path) -> None:
    spec, path = worlds.make('rocket').spec, tmp_path / 'mix.json'
    path.write_text(json.dumps({'pilot': 'expert', 'gains': {'flare_rate': 20.0}}))
    chosen = choose(str(path), spec)
    assert isinstance(chosen.pilot, ExpertPilot)
    assert chosen.pilot.settings.flare_rate == 20.0
    assert chosen.label == 'mix'


@pytest.mark.parametrize(('text', 'message'), [
    ('{', 'tuned gains'), ('[]', 'tuned gains'), ('{"pilot": "nobody", "gains": {}}', 'nobody'),
    ('{"pilot": "expert", "gains": {"courage": 1}}', 'courage'),
    ('{"pilot": "expert", "gains": {"flare_rate": -1}}', 'flare_rate'),
    ('{"pilot": "expert", "gains": {"flare_rate": "x"}}', 'bad.json: flare_rate'),
    ('{"pilot": "expert", "gains": {"spec": 1}}', 'bad.json: .*spec'),
    ('{"pilot": "expert", "gains": [[1, 2]]}', 'bad.json: .*strings'),
    (100_000 * '[', 'RecursionError'),
], ids=range(9))
def test_a_file_that_holds_no_gains_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / 'bad.json'
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        choose(str(path), worlds.make('rocket').spec)


@pytest.mark.parametrize('pilot', ['expert', 'expert_estimator', 'hoverslam'])
def test_rocket_pilots_refuse_other_worlds(tmp_path: Path, pilot: str) -> None:
    path = tmp_path / 'gains.json'
    path.write_text(json.dumps({'pilot': pilot, 'gains': {}}))
    with pytest.raises(ValueError, match='expert'):
        choose(str(path), worlds.make('lunar_lander').spec)
