# SPDX-License-Identifier: Apache-2.0
"""Turns the arguments of train, land, evaluate and fly into arguments of their launch files.

The scripts in launch_scripts call it. It makes the files and folders of a start and writes
`plan.sh`, lines of bash that set the variables that the script needs.
"""
from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field
from datetime import datetime
from pathlib import Path

from ppo_agent_node.atomic_file import write_atomically
from ppo_agent_node.commands.argument_help import explanation
from ppo_agent_node.commands.argument_help import help_text
from ppo_agent_node.commands.arguments import ALL
from ppo_agent_node.commands.arguments import Arguments
from ppo_agent_node.commands.arguments import full_name
from ppo_agent_node.commands.arguments import parse
from ppo_agent_node.commands.parameter_file import LARGEST
from ppo_agent_node.commands.parameter_file import read_parameters
from ppo_agent_node.commands.parameter_file import require_parameters
from ppo_agent_node.commands.parameter_file import write_parameters
from ppo_agent_node.config import presets
from ppo_agent_node.config.connection_config import SECOND
from ppo_agent_node.runs import run_lock
from ppo_agent_node.runs.config_file import read_config
from ppo_agent_node.runs.new_paths import PARTIAL
from ppo_agent_node.runs.new_paths import new_folder
from ppo_agent_node.runs.new_paths import new_recording
from rocket_sim_node import input_file
from rocket_sim_node import ros_environment
from rocket_sim_node.command_line import fail
from rocket_sim_node.command_line import interruptible
from rocket_sim_node.printable import shell_command
from rocket_sim_node.recording.sinks.destinations import check_name
from rocket_sim_node.recording.sinks.destinations import check_page
from rocket_sim_node.recording.sinks.destinations import check_space
from rocket_sim_node.recording.sinks.destinations import check_suffix
from rocket_sim_node.recording.sinks.destinations import page_address
from rocket_sim_node.recording.sinks.destinations import viewer_address
from rocket_sim_node.recording.sinks.rerun_program import LOCAL
from rocket_sim_node.scratch_folder import remove_leftovers

PLAN = 'plan.sh'
_HAS_CORES = len(os.sched_getaffinity(0)) > 1
_NODES = {
    'simulator_parameters': 'simulator',
    **dict.fromkeys(('agent_parameters', 'agent_overrides', 'agent_settings'), 'ppo_agent')}
"""the node that a file of parameters is for, by the argument that names it"""
_OF_THE_START = ('run_dir', 'resume')
_OF_EACH_START = ('record', 'loggers', 'namespace', 'connect', 'serve_web', 'web_port', 'web_host')
"""arguments that a run does not store"""
_HIGHEST_PORT = 65535


def project_of(script: str) -> Path:
    """Return the folder of the project to which a script of `launch_scripts` belongs."""
    return (Path.cwd() / script).parent.parent


@dataclass
class Start:
    """One start of a command: how it was called, and what its launch and its script need."""

    script: str
    pid: int
    """of the script"""
    scratch: Path
    """temporary folder, which the script removes at its end"""
    arguments: Arguments
    launch: dict[str, str] = field(default_factory=dict)
    """the arguments of the launch that differ from its defaults"""
    script_variables: dict[str, str | list[str]] = field(default_factory=dict)
    """variables for the script"""

    def node(self, name: str) -> str:
        """Return the full name of a node of the launch."""
        return full_name(self.launch.get('namespace', ''), name)

    @property
    def runs(self) -> Path:
        """Folder of all runs."""
        return project_of(self.script) / 'runs'


def decided(start: Start) -> dict[str, str]:
    """Return the arguments of the launch that a command decides, where they are not given."""
    given, command = start.arguments, start.arguments.command
    found = dict(given.saved)
    if command == 'train':
        found.setdefault('num_envs', str(presets.preset_num_envs(given.preset, given.world)))
        # The simulator has to show what the policy of the preset observes.
        seen = presets.preset_values(given.preset, given.world).get('observation')
        if seen:
            found.setdefault('observation', seen)
    else:
        # Keeps the nodes apart from those of a training that runs at the same time.
        if 'namespace' not in given.given:
            found['namespace'] = f'/{command}_{start.pid}'
    if command == 'fly' and given.launch.get('connect'):
        found['serve_web'] = 'false'
    return {name: value for name, value in found.items() if name not in given.launch}


def prepare(start: Start) -> None:
    """Make the files and folders of a start, and set what its launch and its script need.

    :raises ValueError: naming an argument that does not fit.
    :raises OSError: when a file or folder cannot be made or read.
    """
    ros_environment.check(os.environ)
    ros_environment.check_shared_memory()
    start.launch = {**start.arguments.launch, **decided(start)}
    _check_recorder(start)
    for name in sorted(start.launch.keys() & _NODES.keys()):
        require_parameters(name, Path(start.launch[name]), start.node(_NODES[name]))
    output = start.launch.get('output', '')
    if start.arguments.command in ('land', 'fly') and output and Path(output).exists():
        raise ValueError(f'output: {output} already exists')
    {'train': _train, 'land': _land, 'evaluate': _evaluate, 'fly': _fly}[
        start.arguments.command](start)
    if start.arguments.simulator and start.arguments.command != 'train':
        _write_simulator(start, start.scratch / 'simulator.yaml')
    start.script_variables['arguments'] = [
        f'{name}:={value}' for name, value in start.launch.items()]


def _check_recorder(start: Start) -> None:
    """Check that the recorder can have what it is asked for, before anything flies.

    :raises ValueError: naming an argument.
    """
    declared = start.arguments.declared
    given = {
        name: start.launch.get(name) or (declared[name].default if name in declared else None)
        for name in ('record', 'connect', 'serve_web', 'web_port', 'web_host')}
    connect, page = given['connect'], given['serve_web'] == 'true'
    if given['record'] == 'false':
        for name, value in (('connect', connect), ('serve_web', page and 'true')):
            if value:
                raise ValueError(
                    f'{name}: got {value!r}, expected none beside record:=false, which starts no '
                    'recorder')
    if connect:
        viewer_address(connect)
    if given['web_port'] is not None:
        host, port = given['web_host'] or LOCAL, int(given['web_port'])
        page_address(host)
        if not 1 <= port <= _HIGHEST_PORT:
            raise ValueError(f'web_port: got {port}, expected 1 to {_HIGHEST_PORT}')
        if page:
            check_page(port, host)


def _check_room(recording: Path) -> None:
    """Check that a recording can be written where it is wanted.

    :raises ValueError: when its name is not that of a recording, or too long.
    :raises OSError: when its folder is not writable or its disk is nearly full.
    """
    check_suffix(recording)
    folder = next(path for path in recording.parents if path.exists())
    check_name(recording.name, folder)
    if not (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)):
        raise OSError(f'no recording can be written in {folder}')
    check_space(folder)


def _write_simulator(start: Start, path: Path) -> None:
    """Write a file of simulator parameters: the one that was named, and the world's settings."""
    values = start.arguments.values(start.launch)
    write_parameters(path, start.node('simulator'), start.arguments.simulator,
                     Path(values['simulator_parameters']))
    start.launch['simulator_parameters'] = str(path)


def _train(start: Start) -> None:
    given, launch = start.arguments, start.launch
    resumed = launch.get('resume') == 'true'
    vehicle = launch.get('simulator_parameters')
    if 'run_dir' in launch and run_lock.in_use(Path(launch['run_dir'])):
        raise ValueError(f'run_dir: another process is training in {launch["run_dir"]}')
    begun = (Path(launch.get('run_dir', '')) / 'config.yaml').exists()
    if resumed and not begun:
        raise ValueError(
            f'run_dir: {launch["run_dir"]} holds no run to resume (it has no config.yaml); name '
            'the folder of a run, or leave out resume:=true to begin one there')
    if not resumed and begun:
        raise ValueError(
            f'run_dir: {launch["run_dir"]} already holds a run; resume it with resume:=true, or '
            'name another folder')
    if launch.get('record') != 'false':
        _check_room(Path(launch.get('run_dir') or start.runs) / 'recording.rrd')
    if 'run_dir' not in launch:
        launch['run_dir'] = str(new_folder(start.runs / f'{given.world}-{_now()}'))
    run = Path(launch['run_dir'])
    kept = run / 'simulator.yaml'
    start.script_variables['made'] = ''
    if resumed:
        if not vehicle and kept.is_file():
            require_parameters('run_dir', kept, start.node('simulator'))
            launch['simulator_parameters'] = str(kept)
        if given.simulator:
            _write_simulator(start, start.scratch / 'simulator.yaml')
    elif vehicle or given.simulator:
        run.mkdir(parents=True, exist_ok=True)
        start.script_variables['made'] = '' if kept.exists() else str(kept)
        if given.simulator:
            _write_simulator(start, kept)
        elif vehicle and Path(vehicle).resolve() != kept.resolve():
            write_atomically(kept, input_file.read_bytes(Path(vehicle), LARGEST))
    if given.agent:
        launch['agent_settings'] = str(start.scratch / 'agent.yaml')
        write_parameters(
            Path(launch['agent_settings']), start.node('ppo_agent'), given.agent)
    if _flies_two_groups(start):
        launch['second_simulator'] = SECOND
    start.script_variables.update({'run': str(run), 'resumed': str(resumed).lower()})
    # How to resume the run; until it has written its settings it has to be started again.
    words = [os.environ.get('HOVERSLAM_SECURE', ''), start.script, f'run_dir:={run}']
    words = [word for word in words if word]
    shown = [f'{name}:={value}' for name, value in given.given.items() if name in _OF_EACH_START]
    every = [f'{name}:={value}' for name, value in given.given.items()
             if name not in _OF_THE_START]
    start.script_variables['resume'] = shell_command([*words, 'resume:=true', *shown])
    start.script_variables['begin_again'] = shell_command([*words, *every])


def _flies_two_groups(start: Start) -> bool:
    """Return whether a training starts two simulators.

    They fly two groups of a roll-out at the same time, with the same results.
    """
    if start.arguments.given.keys() & {'second_simulator', 'simulators'} or not _HAS_CORES:
        return False
    if file := start.launch.get('simulator_parameters'):
        of_first, of_second = (
            read_parameters(Path(file), start.node(name))
            for name in ('simulator', f'{SECOND}/simulator'))
        if of_first != of_second:
            return False
    return _num_groups(start) > 1


def _num_groups(start: Start) -> int:
    """Return the number of groups of a roll-out."""
    given, launch = start.arguments, start.launch
    values = dict(presets.preset_values(given.preset, given.world))
    if launch.get('resume') == 'true':
        values.update(read_config(Path(launch['run_dir']) / 'config.yaml').get('training', {}))
    for name in ('agent_parameters', 'agent_overrides', 'agent_settings'):
        if file := launch.get(name):
            values.update(read_parameters(Path(file), start.node('ppo_agent')))
    return int(values.get('num_groups', 1))


def _land(start: Start) -> None:
    start.script_variables['partial'] = ''
    _check_room(Path(start.launch.get('output') or start.runs / 'landing.rrd'))
    if 'output' not in start.launch:
        output = new_recording(start.runs / f'landing-{_now()}.rrd')
        start.launch['output'] = str(output)
        start.script_variables['partial'] = str(output.with_name(output.stem + PARTIAL))
    start.script_variables['output'] = start.launch['output']


def _evaluate(start: Start) -> None:
    start.script_variables['made'] = ''
    if start.launch.get('conditions') == ALL and 'output' not in start.launch:
        # A table takes minutes to fly: its figures are kept in files.
        start.launch['output'] = str(new_folder(start.runs / f'conditions-{_now()}'))
        start.script_variables['made'] = start.launch['output']


def _fly(start: Start) -> None:
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise ValueError('standard input: got no terminal, expected one to read keys from')
    given, pilot = start.arguments, []
    if 'output' in start.launch:
        _check_room(Path(start.launch['output']))
    for name, value in given.agent.items():
        pilot += ['-p', f'{name}:={str(value).lower()}']
    start.script_variables.update({
        'pilot': pilot, 'output': start.launch.get('output', ''),
        **{name: start.launch.get(name) or given.of_launch(name)
           for name in ('namespace', 'serve_web', 'connect')}})


def _now() -> str:
    return f'{datetime.now():%Y%m%d-%H%M%S}'


def _bash(variables: dict[str, str | list[str]]) -> str:
    """Return variables as lines of bash."""
    return ''.join(
        f'{name}={shlex.quote(value)}\n' if isinstance(value, str)
        else f'{name}=({shlex.join(value)})\n' for name, value in variables.items())


def run(script: str, pid: int, scratch: Path, texts: Sequence[str]) -> str:
    """Start a command; return what to print.

    :raises ValueError: naming an argument, what was given and what was expected.
    :raises TypeError: for a value of another kind.
    :raises OSError: when a file or folder cannot be read or made.
    """
    path = Path(script)
    asked = {'-h', '--help'} & set(texts)
    words = [text for text in texts if text not in ('-h', '--help')]
    names = [word for word in words if asked and ':=' not in word]
    file = project_of(script) / 'ppo_agent_node' / 'launch' / f'{path.name}.launch.yaml'
    found = parse(path.name, file, [word for word in words if word not in names])
    start = Start(script, pid, scratch, found)
    if not asked:
        prepare(start)
        (scratch / PLAN).write_text(_bash(start.script_variables), 'utf-8')
        return ''
    decisions = {**decided(start), **placeholders(start)}
    if names:
        return explanation(names, found, decisions)
    return help_text(script, found, decisions)


def placeholders(start: Start) -> dict[str, str]:
    """Return what the help shows for names that each start makes anew."""
    command, given = start.arguments.command, start.arguments.given
    shown = {
        'train': {'run_dir': f'runs/{start.arguments.world}-DATE'},
        'land': {'output': 'runs/landing-DATE.rrd'}}.get(command, {})
    if command != 'train':
        shown['namespace'] = f'/{command}_PID'
    return {name: value for name, value in shown.items() if name not in given}


def main() -> None:
    """Run the command: SCRIPT PID SCRATCH [ARGUMENT ...]."""
    script, pid, scratch, *texts = sys.argv[1:]
    try:
        with interruptible():
            remove_leftovers(Path(scratch).parent)
            sys.stdout.write(run(script, int(pid), Path(scratch), texts))
    except (ValueError, TypeError, OSError) as error:
        fail(Path(script).name, ValueError(' '.join(str(error).split())))


if __name__ == '__main__':
    main()
