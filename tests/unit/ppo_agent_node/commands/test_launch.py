# SPDX-License-Identifier: Apache-2.0
"""How commands start: launch arguments, the files that are made, and help."""
from __future__ import annotations

import fcntl
import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
import rerun as rr
import yaml

from ppo_agent_node.commands import launch
from rocket_sim_node.recording.sinks import rerun_program

ROOT = Path(__file__).parents[4]
SCRIPTS, LAUNCH_FILES = ROOT / 'launch_scripts', ROOT / 'ppo_agent_node' / 'launch'


class Project:
    """A copy of the launch files, and a folder that scripts call their own."""

    def __init__(self, folder: Path) -> None:
        self.root, self.scratch = folder / 'project', folder / 'scratch'
        self.scripts = self.root / 'launch_scripts'
        self.scratch.mkdir()
        self.scripts.mkdir(parents=True)
        self.launch_files = self.root / 'ppo_agent_node' / 'launch'
        shutil.copytree(LAUNCH_FILES, self.launch_files)

    def run(self, command: str, *texts: str) -> str:
        """Return what is printed."""
        return launch.run(str(self.scripts / command), 42, self.scratch, texts)

    def begin(self, command: str, *texts: str) -> dict[str, str]:
        """Return the arguments of the launch by name."""
        assert self.run(command, *texts) == ''
        return dict(text.split(':=', 1) for text in self.variable('arguments[@]'))

    def add_script(self, command: str, programs: Path, launch: str) -> None:
        """Add the script of a command, whose `ros2` in folder `programs` is a script as well."""
        programs.mkdir()
        (programs / 'ros2').write_text(launch)
        (programs / 'ros2').chmod(0o755)
        for name in (command, 'attend.sh', 'command.sh'):
            shutil.copy(SCRIPTS / name, self.scripts)
        (self.scripts / 'env.sh').write_text(f'PATH={programs}:$PATH\n')

    def variable(self, name: str) -> list[str]:
        """Return what bash makes of a variable, word by word."""
        done = subprocess.run(
            ['bash', '-euc', f'. "$1/plan.sh"; printf "%s\\0" "${{{name}}}"', 'x', self.scratch],
            capture_output=True, text=True, check=True, timeout=20)
        return done.stdout.split('\0')[:-1]


@pytest.fixture
def project(tmp_path: Path) -> Project:
    return Project(tmp_path)


def parameters(path: str | Path) -> dict[str, object]:
    return yaml.safe_load(Path(path).read_text())['/**']['ros__parameters']


@pytest.mark.parametrize(('given', 'num_envs'), [
    ([], '256'), (['world:=rocket_planar'], '256'), (['world:=lunar_lander'], '128'),
    (['world:=lunar_lander', 'preset:=original'], '8'), (['preset:=original'], '256'),
    (['world:=lunar_lander', 'preset:=from_scratch'], '100'),
    (['world:=lunar_lander', 'preset:=quick'], '128'), (['num_envs:=3'], '3')])
def test_world_and_preset_set_the_number_of_environments(
        project: Project, given: list[str], num_envs: str) -> None:
    assert project.begin('train', *given)['num_envs'] == num_envs


@pytest.mark.parametrize(('given', 'seen'), [
    ([], None), (['preset:=robust'], 'extended'), (['preset:=hoverslam'], 'extended'),
    (['preset:=robust', 'observation:=standard'], 'standard'), (['world:=lunar_lander'], None)])
def test_the_preset_selects_the_observation(
        project: Project, given: list[str], seen: str | None) -> None:
    assert project.begin('train', *given).get('observation') == seen


@pytest.mark.parametrize(('given', 'second'), [
    ([], 'simulator_2'), (['preset:=robust', 'max_thrust:=500000'], 'simulator_2'),
    (['preset:=from_scratch'], None), (['world:=lunar_lander'], 'simulator_2'),
    (['world:=lunar_lander', 'preset:=quick'], None), (['simulators:=/sim_*'], None),
    (['second_simulator:='], None), (['second_simulator:=b'], 'b'),
    (['world:=lunar_lander', 'preset:=quick', 'num_groups:=4'], 'simulator_2')])
def test_two_groups_are_flown_by_two_simulators(
        project: Project, given: list[str], second: str | None,
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(launch, '_HAS_CORES', True)
    assert project.begin('train', *given).get('second_simulator') == second
    monkeypatch.setattr(launch, '_HAS_CORES', False)
    assert project.begin('train', *given).get('second_simulator') == (
        'b' if second == 'b' else None)


@pytest.mark.parametrize(('node', 'second'), [
    ('/**', 'simulator_2'), ('/**/simulator', 'simulator_2'), ('/simulator', None)])
def test_both_simulators_fly_the_vehicle_of_a_file_also_after_a_resume(
        project: Project, tmp_path: Path, node: str, second: str | None,
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(launch, '_HAS_CORES', True)
    file, run = tmp_path / 'vehicle.yaml', tmp_path / 'run'
    file.write_text(f'{node}: {{ros__parameters: {{max_thrust: 500000.0}}}}\n')
    begun = project.begin('train', f'simulator_parameters:={file}', f'run_dir:={run}')
    assert begun.get('second_simulator') == second
    config = 'world: rocket\nnum_envs: 8\ntraining: {num_groups: %d}\n'
    (run / 'config.yaml').write_text(config % 2)
    again = project.begin('train', f'run_dir:={run}', 'resume:=true')
    assert again.get('second_simulator') == second
    (run / 'config.yaml').write_text(config % 1)
    again = project.begin('train', f'run_dir:={run}', 'resume:=true')
    assert 'second_simulator' not in again


@pytest.mark.parametrize('command', ['land', 'evaluate'])
def test_land_and_evaluate_have_a_namespace_of_their_own(project: Project, command: str) -> None:
    assert project.begin(command)['namespace'] == f'/{command}_42'


def test_a_namespace_that_is_given_stays(project: Project) -> None:
    assert project.begin('land', 'namespace:=x')['namespace'] == '/x'
    assert 'namespace' not in project.begin('land', 'namespace:=')
    assert 'namespace' not in project.begin('train')


def test_a_training_keeps_its_vehicle_and_resumes_with_it(project: Project) -> None:
    run, mine = project.root / 'a run', project.root / 'mine.yaml'
    mine.write_text('/**:\n  ros__parameters: {dry_mass: 2.1e4, fuel: 1500}\n')
    texts = (f'run_dir:={run}', 'max_thrust:=500000', 'fuel:=1200', 'seed:=3')
    begun = project.begin('train', f'simulator_parameters:={mine}', *texts)
    kept = run / 'simulator.yaml'
    assert begun['simulator_parameters'] == str(kept)
    kept_parameters = parameters(kept)
    assert (kept_parameters['fuel'], kept_parameters['max_thrust']) == (1200.0, 500_000.0)
    assert 'dry_mass: 2.1e4,' in kept.read_text(), 'a number for ROS, if not for YAML 1.1'
    assert parameters(begun['agent_settings']) == {'seed': 3}
    assert project.variable('made') == [str(kept)]
    first, again = project.variable('begin_again')[0], project.variable('resume')[0]
    script = str(project.scripts / 'train')
    assert shlex.split(again) == [script, f'run_dir:={run}', 'resume:=true']
    assert shlex.split(first) == [script, texts[0], f'simulator_parameters:={mine}', *texts[1:]]
    (run / 'config.yaml').write_text('world: rocket\nnum_envs: 8\n')
    resumed = project.begin('train', f'run_dir:={run}', 'resume:=true')
    assert (resumed['simulator_parameters'], resumed['num_envs']) == (str(kept), '8')
    with pytest.raises(ValueError, match=r'run_dir: .* already holds a run'):
        project.begin('train', *texts)
    assert project.variable('made') == [''], 'what was there stays when nothing begins'


def test_a_vehicle_from_a_file_is_kept_as_it_is(project: Project) -> None:
    mine = project.root / 'mine.yaml'
    mine.write_text('# of mine\n/**:\n  ros__parameters: {fuel: 1500}\n')
    begun = project.begin('train', f'simulator_parameters:={mine}')
    assert (Path(begun['run_dir']) / 'simulator.yaml').read_text() == mine.read_text()
    with pytest.raises(ValueError, match='simulator_parameters: no file /no/where'):
        project.begin('train', 'simulator_parameters:=/no/where')


def test_a_parameter_file_may_address_the_node_by_its_name(project: Project) -> None:
    mine = project.root / 'mine.yaml'
    mine.write_text('/ns: {simulator: {ros__parameters: {fuel: 1500, seed: 3}}}\n'
                    'other: {ros__parameters: {fuel: 1}}\n')
    begun = project.begin(
        'land', f'simulator_parameters:={mine}', 'fuel:=1200', 'namespace:=ns')
    written = yaml.safe_load(Path(begun['simulator_parameters']).read_text())
    assert written == {
        '/ns': {'simulator': {'ros__parameters': {'fuel': 1200.0, 'seed': 3}}},
        'other': {'ros__parameters': {'fuel': 1}}}


@pytest.mark.parametrize(('text', 'named'), [
    ('simulater: {ros__parameters: {fuel: 1}}', '/simulater'),
    ('/other/simulator: {ros__parameters: {fuel: 1}}', '/other/simulator'),
    ('simulator: {ros__parameters: {fuel: 1}}', '/simulator'),
    ('/**: {ros__parameters: {}}', 'no node'), ('', 'no node'), ('# a remark', 'no node'),
    ('hello world', 'hello world'), ('#!/bin/sh\necho "$@"', 'echo'), ('{', 'expected'),
    ('/**: {ros__parameters: {fuel: &a 1, seed: *a}}', 'refers to another value'),
    ('/**: {ros__parameters: {fuel: 1, fuel: 2}}', "names 'fuel' twice")])
@pytest.mark.parametrize('command', ['train', 'land', 'evaluate', 'fly'])
def test_a_file_without_parameters_for_its_node_ends_the_start(
        project: Project, command: str, text: str, named: str) -> None:
    mine = project.root / 'mine.yaml'
    mine.write_text(text)
    with pytest.raises(ValueError, match=r'simulator_parameters: .*mine\.yaml') as caught:
        project.begin(command, f'simulator_parameters:={mine}', 'namespace:=ns')
    assert named in str(caught.value)
    if 'has no parameters' in str(caught.value):
        assert 'for node /ns/simulator: got those of' in str(caught.value)
    assert not (project.root / 'runs').exists()


@pytest.mark.parametrize('name', ['agent_parameters', 'agent_overrides', 'agent_settings'])
def test_a_file_without_parameters_for_the_agent_ends_the_start(
        project: Project, name: str) -> None:
    mine = project.root / 'mine.yaml'
    mine.write_text('ppo_agnet: {ros__parameters: {seed: 3}}')
    with pytest.raises(ValueError, match=rf'{name}: .*has no parameters for node /ppo_agent: got'):
        project.begin('train', f'{name}:={mine}')
    mine.write_text('ppo_agent: {ros__parameters: {seed: 3}}')
    assert project.begin('train', f'{name}:={mine}')[name] == str(mine)


@pytest.mark.parametrize('text', [
    '/**:\r\n  ros__parameters:\r\n    fuel: 1500.0\r\n',
    '"/**":\n  \'ros__parameters\':\n    "fuel": 1500.0\n'])
def test_quotes_and_the_line_ends_of_windows_are_read(project: Project, text: str) -> None:
    mine = project.root / 'mine.yaml'
    mine.write_text(text, newline='')
    run = project.root / 'run'
    project.begin('train', f'simulator_parameters:={mine}', f'run_dir:={run}', 'seed:=3')
    assert (run / 'simulator.yaml').read_bytes() == mine.read_bytes()
    begun = project.begin('land', f'simulator_parameters:={mine}', 'dry_mass:=21000')
    assert parameters(begun['simulator_parameters']) == {'fuel': 1500.0, 'dry_mass': 21000.0}


@pytest.mark.parametrize('make', [
    lambda path: path.symlink_to('/dev/zero'), os.mkfifo, Path.mkdir,
    lambda path: os.truncate(os.open(path, os.O_CREAT | os.O_WRONLY), 2**40)])
def test_special_and_oversized_files_are_never_read(
        project: Project, make: Callable[[Path], None]) -> None:
    mine = project.root / 'mine.yaml'
    make(mine)
    for command in ('train', 'land', 'evaluate'):
        with pytest.raises(ValueError, match=r'simulator_parameters: .*: got .*, expected '):
            project.begin(command, f'simulator_parameters:={mine}')
    assert not (project.root / 'runs').exists()


def test_a_second_training_of_the_same_run_is_refused(project: Project) -> None:
    run = project.root / 'run'
    run.mkdir()
    with (run / '.lock').open('w') as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        for more in ([], ['resume:=true']):
            with pytest.raises(ValueError, match=f'run_dir: another process is training in {run}'):
                project.begin('train', f'run_dir:={run}', *more)
            (run / 'config.yaml').write_text('world: rocket\nnum_envs: 8\n')
    assert project.begin('train', f'run_dir:={run}', 'resume:=true')['run_dir'] == str(run)


def test_a_folder_without_a_run_is_not_resumed(project: Project) -> None:
    run = project.root / 'run'
    expected = re.escape(
        f'run_dir: {run} holds no run to resume (it has no config.yaml); name the folder of a '
        'run, or leave out resume:=true to begin one there')
    for _ in range(2):
        with pytest.raises(ValueError, match=f'^{expected}$'):
            project.begin('train', f'run_dir:={run}', 'resume:=true', 'fuel:=1200')
        assert not run.exists() or not list(run.iterdir())
        run.mkdir(exist_ok=True)


@pytest.mark.parametrize('value', ['abc', '-1', '233', '1.5', ' 1'])
def test_a_domain_that_ros_would_refuse_is_named(
        project: Project, monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', value)
    with pytest.raises(ValueError, match=f"ROS_DOMAIN_ID: got '{value}', expected a whole number"):
        project.begin('land')


@pytest.mark.parametrize('text', ['[1, 2]', '{', 'a: 3', '/**: {ros__parameters: 3}'])
def test_a_file_without_ros_parameters_is_named(project: Project, text: str) -> None:
    mine = project.root / 'mine.yaml'
    mine.write_text(text)
    with pytest.raises(ValueError, match=r'simulator_parameters: .*mine\.yaml: .*expected a fi'):
        project.begin('land', f'simulator_parameters:={mine}', 'fuel:=1200')


@pytest.mark.parametrize('text', [
    '', 'auto', 'a: b', 'a #b', 'ends:', '*x', "it's: x", '- x', '{a', '~/x', '!x', '5', 'true'])
def test_a_text_is_written_unchanged_to_a_parameter_file(project: Project, text: str) -> None:
    begun = project.begin('train', f'fine_observations:={text}')
    assert parameters(begun['agent_settings']) == {'fine_observations': text}


def test_recordings_and_folders_get_names_of_their_own(project: Project) -> None:
    first, second = (project.begin('land')['output'] for _ in range(2))
    assert first != second
    partial = Path(project.variable('partial')[0])
    assert partial.read_bytes() == b'' and partial.name.endswith('.partial.rrd')
    table = project.begin('evaluate', 'conditions:=all')['output']
    assert Path(table).is_dir() and project.variable('made') == [table]
    assert 'output' not in project.begin('evaluate')
    Path(second).touch()
    with pytest.raises(ValueError, match=r'output: .* already exists'):
        project.begin('land', f'output:={second}')


def test_the_name_of_a_recording_leaves_room_for_that_of_its_partial_file(
        project: Project) -> None:
    longest = project.root / ('x' * 230 + '.rrd')
    assert project.begin('land', f'output:={longest}')['output'] == str(longest)
    with pytest.raises(ValueError, match=r'output: got a name of 238 bytes, x+…, expected at'):
        project.begin('land', f"output:={longest.with_stem('x' * 234)}")


def test_the_pilot_of_fly_gets_its_parameters(
        project: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match='standard input: got no terminal'):
        project.begin('fly')
    for stream in (sys.stdin, sys.stdout):
        monkeypatch.setattr(stream, 'isatty', lambda: True, raising=False)
    begun = project.begin('fly', 'assist:=false', 'level:=3', 'lean:=12', 'connect:=rerun://x/proxy')
    assert project.variable('pilot[@]') == [
        '-p', 'assist:=false', '-p', 'level:=3', '-p', 'lean:=12.0']
    assert (begun['serve_web'], project.variable('namespace')) == ('false', ['/fly_42'])


@pytest.mark.parametrize('command', ['train', 'land', 'evaluate', 'fly'])
def test_help_names_each_argument_with_its_default(project: Project, command: str) -> None:
    printed = project.run(command, '--help')
    declared = yaml.safe_load((LAUNCH_FILES / f'{command}.launch.yaml').read_text())['launch']
    for entry in declared:
        if 'arg' in entry:
            assert f'\n  {entry["arg"]["name"]} ' in printed
    assert '$(' not in printed and "['" not in printed
    assert '[ppo_agent_node/launch/parameters/simulator.yaml]' in printed
    assert 'max_thrust:=470880' in printed
    assert max(map(len, printed.splitlines()[1:-1])) <= 99
    assert not (project.root / 'runs').exists() and not list(project.scratch.iterdir())


def test_help_shows_the_defaults_for_the_given_arguments(project: Project) -> None:
    printed = project.run('train', 'world:=lunar_lander', 'preset:=from_scratch', '--help')
    assert 'one batch; the script train chooses the number by world and preset [100]' in ' '.join(
        printed.split())
    assert 'hidden_sizes:=[64,64]' in printed and 'runs/lunar_lander-DATE' in printed
    assert 'engine_lag' not in printed
    (project.launch_files / 'parameters' / 'agent.yaml').write_text(
        '/**:\n  ros__parameters: {clip_range: 0.125}\n')
    assert 'clip_range:=0.125' in project.run('train', '-h')


def test_help_explains_the_names_that_it_is_given(project: Project) -> None:
    printed = project.run('train', '--help', 'max_thrust', 'clip_range', 'num_envs')
    assert [line.split()[0] for line in printed.splitlines() if line[:3].strip()] == [
        'max_thrust', 'clip_range', 'num_envs']
    assert 'thrust at full throttle; 0 to 1e+09 N [470880]' in printed
    assert '0 to 2147483647 [1]' in project.run('train', '--help', 'seed')
    with pytest.raises(ValueError, match="did you mean 'max_thrust'"):
        project.run('train', '--help', 'max_trust')


def test_an_error_is_one_line_with_status_2(project: Project) -> None:
    done = subprocess.run(
        [sys.executable, '-m', 'ppo_agent_node.commands.launch', project.scripts / 'train', '42',
         project.scratch, 'world:=mars'], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (
        2, '', "train: world: got 'mars', expected one of rocket, rocket_planar, lunar_lander\n")


@pytest.mark.parametrize('command', ['train', 'land'])
@pytest.mark.parametrize(('given', 'words'), [
    (['connect:=nonsense'], "connect: got 'nonsense', expected a URL like rerun+http"),
    (['connect:=rerun+http://h:99999/proxy'], 'connect: got'),
    (['web_port:=70000'], 'web_port: got 70000, expected 1 to 65535'),
    (['web_host:=999.1.1.1'], "web_host: got '999.1.1.1', expected an IPv4 address"),
    (['serve_web:=true', 'web_host:=192.0.2.7'], 'expected an address of this machine'),
])
def test_invalid_recorder_arguments_end_the_start(
        project: Project, command: str, given: list[str], words: str) -> None:
    with pytest.raises(ValueError, match=re.escape(words)):
        project.begin(command, *given)
    assert not (project.root / 'runs').exists()


@pytest.mark.parametrize('command', ['train', 'land'])
def test_a_port_that_is_taken_ends_the_start(project: Project, command: str) -> None:
    with socket.create_server(('127.0.0.1', 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ValueError, match=f'web_port: {port} is taken by another program'):
            project.begin(command, 'serve_web:=true', f'web_port:={port}')
        project.begin(command, f'web_port:={port}')  # no page was requested


def test_the_web_page_cannot_be_served_without_a_recorder(project: Project) -> None:
    with pytest.raises(ValueError, match='expected none beside record:=false'):
        project.begin('train', 'record:=false', 'serve_web:=true')


def test_a_recording_needs_a_folder_and_room(
        project: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(OSError, match='no recording can be written in'):
        project.begin('land', f'output:={__file__}/x.rrd')
    with pytest.raises(ValueError, match=r'expected a name that ends with \.rrd'):
        project.begin('land', 'output:=flights')
    monkeypatch.setattr(shutil, 'disk_usage', lambda path: SimpleNamespace(free=2**20))
    for command in ('train', 'land'):
        with pytest.raises(OSError, match='only 1 MiB of disk left'):
            project.begin(command)
        assert not (project.root / 'runs').exists()
    project.begin('train', 'record:=false')


_LAUNCH = """#!/usr/bin/env bash
# A launch that ends with 0, although its recorder was killed while it ended.
for word; do
  case $word in run_dir:=*) run=${word#*:=} ;; output:=*) output=${word#*:=} ;; esac
done
if [[ ${run:-} ]]; then mkdir -p "$run/checkpoints"; touch "$run"/{config.yaml,evaluation.json}; fi
output=${output:-${run:-}/recording.rrd}
if [[ $* != *record:=false* ]]; then cp "$LEFT" "${output%.rrd}.partial.rrd"; fi
"""


@pytest.mark.parametrize('command', ['train', 'land'])
def test_an_unfinished_recording_is_reported_and_can_be_repaired(
        project: Project, tmp_path: Path, command: str) -> None:
    left, programs = tmp_path / 'left.rrd', tmp_path / 'programs'
    stream = rr.RecordingStream('hoverslam')
    stream.save(left, write_footer=False)
    stream.log('speed', rr.Scalars(3.0))
    stream.disconnect()
    project.add_script(command, programs, _LAUNCH)
    whole = tmp_path / 'flights of today' / 'recording.rrd'
    whole.parent.mkdir()
    where = f'run_dir:={whole.parent}' if command == 'train' else f'output:={whole}'

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [project.scripts / command, where, *arguments], env={**os.environ, 'LEFT': str(left)},
            capture_output=True, text=True, check=False, timeout=30, stdin=subprocess.DEVNULL)

    ended = run()
    assert ended.returncode == 1, ended.stderr
    report, repair = ended.stderr.splitlines()
    assert report.startswith(f'{command}: the recording is incomplete')
    subprocess.run(repair, shell=True, check=True, timeout=30)
    rerun_program.verify(whole)
    assert [path.name for path in whole.parent.glob('*.rrd')] == ['recording.rrd']
    if command == 'train':
        assert ended.stdout.splitlines()[-1] == f'run: {whole.parent}'
        (whole.parent / 'config.yaml').unlink()
        assert run('record:=false').returncode == 0


@pytest.mark.parametrize('begun', [False, True])
def test_a_training_that_fails_early_is_started_again_and_a_later_one_resumed(
        project: Project, tmp_path: Path, begun: bool) -> None:
    run = tmp_path / 'run'
    project.add_script('train', tmp_path / 'programs', f"""#!/usr/bin/env bash
mkdir -p {run}
touch {run}/.unfinished {f'{run}/config.yaml' if begun else ''}
exit 3
""")
    script = project.scripts / 'train'
    ended = subprocess.run(
        [script, f'run_dir:={run}', 'seed:=3'], capture_output=True, text=True, check=False,
        timeout=30, stdin=subprocess.DEVNULL)
    assert ended.returncode == 3, ended.stderr
    assert ended.stdout.splitlines() == (
        ['stopped; continue with:', f'  {script} run_dir:={run} resume:=true'] if begun else
        ['stopped before the run began; start it again with:',
         f'  {script} run_dir:={run} seed:=3'])


@pytest.mark.parametrize(('launch', 'status'), [
    ('exit 0', 1), ('exit 3', 3), ('touch "$HOVERSLAM_DONE"', 0),
    ('kill -INT $PPID; sleep 0.5', 130), ('kill -TERM $PPID; sleep 0.5', 143)])
def test_an_evaluation_that_is_not_done_is_a_failure(
        project: Project, tmp_path: Path, launch: str, status: int) -> None:
    """The launch of a full ROS 2 ends with 0 in any case."""
    project.add_script('evaluate', tmp_path / 'programs', f'#!/usr/bin/env bash\n{launch}\n')
    ended = subprocess.run(
        [project.scripts / 'evaluate'], capture_output=True, text=True, check=False, timeout=30,
        stdin=subprocess.DEVNULL)
    assert (ended.returncode, ended.stderr) == (status, '')
