# SPDX-License-Identifier: Apache-2.0
"""Parameters that the launch files give to the nodes, with and without arguments."""
from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from ros2.launch.actions import carry_out
from ros2.launch.context import Context

ROOT = Path(__file__).parents[3]
FOLDER = {'run_dir': '/run', 'output': '/out.rrd'}


@pytest.fixture(autouse=True)
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install the names of the nodes, of which none is started."""
    prefix = tmp_path / 'install'
    index = prefix / 'share/ament_index/resource_index/packages'
    index.mkdir(parents=True)
    for package, nodes in (
        ('rocket_sim_node', ('simulator', 'rerun_recorder')),
        ('ppo_agent_node', ('ppo_agent', 'evaluate')),
    ):
        (index / package).touch()
        folder = prefix / 'lib' / package
        folder.mkdir(parents=True)
        for node in nodes:
            (folder / node).touch(0o755)
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(prefix))


def parameters_of(tmp_path: Path, file: str, node: str, **arguments: str) -> dict[str, object]:
    """Return the parameters of a node that a launch file starts, the later ones winning."""
    package = 'rocket_sim_node' if file == 'simulate' else 'ppo_agent_node'
    path = ROOT / package / 'launch' / f'{file}.launch.yaml'
    context = Context({**FOLDER, **arguments}, tmp_path / 'log')
    command, = (
        plan.command for plan in carry_out(path, context) if plan.command[0].endswith(f'/{node}'))
    found: dict[str, object] = {}
    for flag, name in zip(command, command[1:], strict=False):
        if flag == '--params-file':
            (_, values), = yaml.safe_load(Path(name).read_text()).items()
            found.update(values['ros__parameters'])
    return found


def parameter_file(path: Path, **values: object) -> str:
    path.write_text(yaml.dump({'/**': {'ros__parameters': values}}))
    return str(path)


@pytest.mark.parametrize('file', ['train', 'land', 'fly', 'simulate'])
@pytest.mark.parametrize(('given', 'expected'), [({}, 'harsh'), ({'conditions': 'mix'}, 'mix')])
def test_given_conditions_override_those_of_a_file(
    tmp_path: Path, file: str, given: dict[str, str], expected: str,
) -> None:
    vehicle = parameter_file(tmp_path / 'vehicle.yaml', conditions='harsh', dry_mass=21_000.0)
    found = parameters_of(
        tmp_path, file, 'simulator', simulator_parameters=vehicle, world='rocket_planar', **given)
    assert (found['conditions'], found['dry_mass']) == (expected, 21_000.0)
    assert found['world'] == 'rocket_planar'


@pytest.mark.parametrize('file', ['train', 'land', 'fly', 'simulate'])
def test_without_a_file_no_conditions_are_set(tmp_path: Path, file: str) -> None:
    found = parameters_of(tmp_path, file, 'simulator')
    assert 'conditions' not in found and found['world'] == 'rocket'


@pytest.mark.parametrize(('given', 'expected'), [({}, 3), ({'level': '5'}, 5)])
def test_a_given_level_overrides_that_of_a_file(
    tmp_path: Path, given: dict[str, str], expected: int,
) -> None:
    vehicle = parameter_file(tmp_path / 'vehicle.yaml', level=3)
    found = parameters_of(
        tmp_path, 'simulate', 'simulator', simulator_parameters=vehicle, num_envs='4', **given)
    assert (found['level'], found['num_envs']) == (expected, 4)


@pytest.mark.parametrize('file', ['train', 'land', 'fly', 'simulate'])
def test_port_and_address_of_the_page_reach_the_recorder(tmp_path: Path, file: str) -> None:
    found = parameters_of(
        tmp_path, file, 'rerun_recorder', serve_web='true', web_port='9123', web_host='127.0.0.2')
    assert (found['web_port'], found['web_host']) == (9123, '127.0.0.2')


@pytest.mark.parametrize('file', ['land', 'evaluate'])
@pytest.mark.parametrize(('given', 'seen'), [
    ({}, 'extended'), ({'world': 'rocket_planar'}, 'extended'),
    ({'world': 'lunar_lander'}, 'standard'), ({'observation': 'standard'}, 'standard')])
def test_rockets_show_what_any_policy_that_ships_observes(
    tmp_path: Path, file: str, given: dict[str, str], seen: str,
) -> None:
    assert parameters_of(tmp_path, file, 'simulator', **given)['observation'] == seen


def test_later_files_of_the_agent_override_earlier_ones(tmp_path: Path) -> None:
    files = {
        'agent_parameters': parameter_file(tmp_path / '1.yaml', gamma=0.9, seed=1, iterations=3),
        'agent_overrides': parameter_file(tmp_path / '2.yaml', seed=2, iterations=4),
        'agent_settings': parameter_file(tmp_path / '3.yaml', iterations=5)}
    found = parameters_of(tmp_path, 'train', 'ppo_agent', **files)
    assert (found['gamma'], found['seed'], found['iterations']) == (0.9, 2, 5)
    del files['agent_settings']
    assert parameters_of(tmp_path, 'train', 'ppo_agent', **files)['iterations'] == 4


@pytest.mark.parametrize(('given', 'conditions', 'observation'), [
    ({}, 'mix', None), ({'conditions': 'harsh'}, 'harsh', None),
    ({'observation': 'extended'}, 'mix', 'extended'),
    ({'observation': 'standard'}, 'mix', 'standard'),
    ({'conditions': 'harsh', 'observation': 'extended', 'resume': 'true'}, 'mix', None)])
def test_given_conditions_and_observation_reach_the_agent_of_a_new_run(
    tmp_path: Path, given: dict[str, str], conditions: str, observation: str | None,
) -> None:
    """A resumed run has its own, whatever the simulators start with."""
    file = parameter_file(tmp_path / 'agent.yaml', conditions='mix')
    agent, simulator = (
        parameters_of(tmp_path, 'train', node, agent_parameters=file, preset='robust', **given)
        for node in ('ppo_agent', 'simulator'))
    assert (agent['preset'], agent['conditions']) == ('robust', conditions)
    assert agent.get('observation') == observation
    assert simulator['observation'] == given.get('observation', 'standard')
    assert simulator.get('conditions') == given.get('conditions')


@pytest.mark.parametrize(('given', 'recorded'), [
    ({}, False), ({'record': 'true'}, True), ({'output': '/out.rrd'}, True),
    ({'connect': 'rerun+http://localhost:9876/proxy'}, True), ({'serve_web': 'true'}, True),
    ({'output': '/out.rrd', 'record': 'false'}, False), ({'record': 'false'}, False),
    ({'serve_web': 'true', 'record': 'false'}, False)])
def test_arguments_that_need_a_recorder_start_one(
    tmp_path: Path, given: dict[str, str], recorded: bool,
) -> None:
    path = ROOT / 'rocket_sim_node/launch/simulate.launch.yaml'
    commands = [plan.command[0] for plan in carry_out(path, Context(given, tmp_path / 'log'))]
    names = [Path(command).name for command in commands]
    assert names == ['simulator', *(['rerun_recorder'] if recorded else [])]
