# SPDX-License-Identifier: Apache-2.0
"""Goals of actions become arguments of commands; episodes become figures."""
from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from rocket_msgs.msg import Episodes

from ppo_agent_node.commands.launch_file import read_launch_file
from ppo_agent_node.nodes.actions.execution import KINDS
from ppo_agent_node.nodes.actions.flight_figures import LANDED
from ppo_agent_node.nodes.actions.flight_figures import EpisodeStatistics
from ppo_agent_node.nodes.actions.flight_figures import no_figures
from ppo_agent_node.nodes.actions.goals import goal_arguments
from ppo_agent_node.nodes.actions.goals import start_of
from ppo_agent_node.nodes.actions.launch_process import LaunchProcess
from rocket_sim_node import worlds

ROOT = Path(__file__).parents[4]
CHOSEN = {
    ('train', 'seed'): 'a setting: that of the preset or the run',
    ('train', 'preset'): 'empty stands for default', ('train', 'num_envs'): 'by preset',
    ('evaluate', 'episodes'): '0 stands for 2000'}
"""fields whose default is not that of the launch file, with the reason"""


@pytest.mark.parametrize(('name', 'fields', 'expected'), [
    ('train', {}, []),
    ('train', {'world': 'lunar_lander', 'seed': 0, 'resume': True, 'record': False},
     ['world:=lunar_lander', 'seed:=0', 'resume:=true', 'record:=false']),
    ('train', {'num_envs': 8, 'arguments': ['gamma:=0.9', 'hidden_sizes:=[16, 16]']},
     ['num_envs:=8', 'gamma:=0.9', 'hidden_sizes:=[16, 16]']),
    ('evaluate', {'episodes': 0, 'optimum_sample': 0}, ['episodes:=0', 'optimum_sample:=0']),
    ('land', {'output': '/a b.rrd', 'episodes': 20}, ['output:=/a b.rrd'])])
def test_a_goal_as_arguments(name: str, fields: dict[str, Any], expected: list[str]) -> None:
    assert goal_arguments(KINDS[name].Goal(**fields)) == expected


@pytest.mark.parametrize(('given', 'complaint'), [
    (['namespace:=/a'], "arguments: got 'namespace:=/a', expected none"),
    (['world:=rocket'], "arguments: got 'world:=rocket', expected field world of the goal"),
    (['gamma:=0.9', 'gamma:=0.8'], "arguments: got 'gamma:=0.9' and 'gamma:=0.8'")])
def test_arguments_that_contradict_the_goal(given: list[str], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        goal_arguments(KINDS['train'].Goal(arguments=given))


@pytest.mark.parametrize('name', list(KINDS))
def test_settings_of_the_world_override_the_installed_parameters(
        name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    goal = KINDS[name].Goal(arguments=['max_thrust:=500000'])
    start = start_of(name, goal, '/', tmp_path)
    written = yaml.safe_load(Path(start.launch['simulator_parameters']).read_text())
    usual = yaml.safe_load((ROOT / 'ppo_agent_node/launch/parameters/simulator.yaml').read_text())
    assert written['/**']['ros__parameters'] == {
        **usual['/**']['ros__parameters'], 'max_thrust': 500000.0}


@pytest.mark.parametrize('name', list(KINDS))
def test_a_field_at_its_default_keeps_that_of_the_command(name: str) -> None:
    """A field at its default is not passed on."""
    declared = read_launch_file(ROOT / 'ppo_agent_node' / 'launch' / f'{name}.launch.yaml')
    usual = KINDS[name].Goal()
    for field in usual.get_fields_and_field_types():
        if field == 'arguments' or (name, field) in CHOSEN:
            continue
        value = getattr(usual, field)
        if value not in ('', 0) or isinstance(value, bool):
            assert str(value).lower() == declared[field].default, field
        else:
            assert field in declared


def test_the_first_outcome_of_every_world_is_landed() -> None:
    for name in worlds.names():
        assert worlds.make(name, 1).spec.outcomes[LANDED] == 'landed'


def test_figures_of_flights() -> None:
    statistics = EpisodeStatistics(8, 7, 'evaluate')
    assert math.isnan(statistics.figures().mean_return)
    assert statistics.figures().episodes == no_figures().episodes == 0
    statistics.add(Episodes(outcome=[0, 1], episode_return=[290.0, -10.0]))
    statistics.add(Episodes(outcome=[0, 0], episode_return=[300.0, 280.0]))
    found = statistics.figures()
    assert (found.episodes, found.landed, found.landing_rate) == (4, 3, 0.75)
    assert found.mean_return == 215.0
    # Wilson's interval for 3 of 4 (Brown, Cai and DasGupta 2001, equation 4).
    assert (found.landing_rate_low, found.landing_rate_high) == pytest.approx(
        (0.3006, 0.9544), abs=1e-4)
    assert 'evaluating 4/8 episodes: level 7, landed 75.0%' in statistics.text()
    assert 'landing 0/8 episodes' in EpisodeStatistics(8, 7, 'land').text()


@pytest.mark.parametrize(('said', 'reason', 'failed'), [
    ('[ppo_agent-3] [FATAL] [12.5] [train.ppo_agent]: policy: no file\nlater', 'policy: no file',
     True),
    ('[INFO] [launch]: all is well\nno such thing', 'no such thing', False)])
def test_the_reason_of_a_failure_is_taken_from_the_log(
    tmp_path: Path, said: str, reason: str, failed: bool,
) -> None:
    process = LaunchProcess(['printf', '%s', said], tmp_path / 'log')
    while not process.ended:
        pass
    assert (process.reason(), process.failed) == (reason, failed)
