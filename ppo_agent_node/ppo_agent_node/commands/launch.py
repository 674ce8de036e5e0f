# SPDX-License-Identifier: Apache-2.0
"""Turns the arguments of train, land, evaluate and fly into arguments of their launch files.

The scripts in launch_scripts call it. It makes the files and folders of a start and writes
`plan.sh`, lines of bash that set the variables that the script needs.
"""
from __future__ import annotations

import os
import shlex
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field
from datetime import datetime
from pathlib import Path

from ppo_agent_node.commands.argument_help import explanation
from ppo_agent_node.commands.argument_help import help_text
from ppo_agent_node.commands.arguments import ALL
from ppo_agent_node.commands.arguments import Arguments
from ppo_agent_node.commands.arguments import parse
from ppo_agent_node.commands.launch_file import resolved
from ppo_agent_node.commands.parameter_file import write_parameters
from ppo_agent_node.config import presets
from ppo_agent_node.runs.new_paths import PARTIAL
from ppo_agent_node.runs.new_paths import new_folder
from ppo_agent_node.runs.new_paths import new_recording
from rocket_sim_node.command_line import interruptible

PLAN = 'plan.sh'
_OF_THE_START = ('run_dir', 'resume')
_OF_EACH_START = ('record', 'namespace', 'connect', 'serve_web', 'web_port', 'web_host')
"""arguments that a run does not store"""


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
    told: dict[str, str | list[str]] = field(default_factory=dict)
    """variables for the script"""

    @property
    def folder(self) -> Path:
        """Folder of the scripts and launch files."""
        return Path.cwd() / Path(self.script).parent

    @property
    def runs(self) -> Path:
        """Folder of all runs."""
        return self.folder.parent / 'runs'


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
        # Each pilot takes the columns that it knows.
        if 'observation' in given.declared and given.world.startswith('rocket'):
            found['observation'] = 'extended'
    if command == 'fly' and given.launch.get('connect'):
        found['serve_web'] = 'false'
    return {name: value for name, value in found.items() if name not in given.launch}


def prepare(start: Start) -> None:
    """Make the files and folders of a start, and set what its launch and its script need.

    :raises ValueError: naming an argument that does not fit.
    :raises OSError: when a file or folder cannot be made or read.
    """
    start.launch = {**start.arguments.launch, **decided(start)}
    output = start.launch.get('output', '')
    if start.arguments.command in ('land', 'fly') and output and Path(output).exists():
        raise ValueError(f'output: {output} exists already')
    {'train': _train, 'land': _land, 'evaluate': _evaluate, 'fly': _fly}[
        start.arguments.command](start)
    if start.arguments.simulator and start.arguments.command != 'train':
        _write_simulator(start, start.scratch / 'simulator.yaml')
    start.told['arguments'] = [f'{name}:={value}' for name, value in start.launch.items()]


def _write_simulator(start: Start, path: Path) -> None:
    """Write a file of simulator parameters: the one that was named, and the world's settings."""
    base = resolved(start.arguments.declared, start.launch, start.folder)['simulator_parameters']
    write_parameters(path, 'simulator', start.arguments.simulator, Path(base))
    start.launch['simulator_parameters'] = str(path)


def _train(start: Start) -> None:
    given, launch = start.arguments, start.launch
    resumed = launch.get('resume') == 'true'
    vehicle = launch.get('simulator_parameters')
    if vehicle and not os.access(vehicle, os.R_OK):
        raise ValueError(f'simulator_parameters: no file {vehicle}')
    if not resumed and (Path(launch.get('run_dir', '')) / 'config.yaml').exists():
        raise ValueError(
            f'run_dir: there is a run already in {launch["run_dir"]}; go on with resume:=true or '
            'name another folder')
    if 'run_dir' not in launch:
        launch['run_dir'] = str(new_folder(start.runs / f'{given.world}-{_now()}'))
    run = Path(launch['run_dir'])
    kept = run / 'simulator.yaml'
    start.told['made'] = ''
    if resumed:
        if not vehicle and kept.is_file():
            launch['simulator_parameters'] = str(kept)
        if given.simulator:
            _write_simulator(start, start.scratch / 'simulator.yaml')
    elif vehicle or given.simulator:
        run.mkdir(parents=True, exist_ok=True)
        start.told['made'] = '' if kept.exists() else str(kept)
        if given.simulator:
            _write_simulator(start, kept)
        elif vehicle and Path(vehicle).resolve() != kept.resolve():
            shutil.copyfile(vehicle, kept)
    if given.agent:
        launch['agent_settings'] = str(start.scratch / 'agent.yaml')
        write_parameters(Path(launch['agent_settings']), 'ppo_agent', given.agent)
    start.told['run'] = str(run)
    # How to resume the run; until it has written its settings they have to be repeated.
    words = [os.environ.get('HOVERSLAM_SECURE', ''), start.script, f'run_dir:={run}']
    words = [word for word in (*words, 'resume:=true') if word]
    shown = [f'{name}:={value}' for name, value in given.given.items() if name in _OF_EACH_START]
    every = [f'{name}:={value}' for name, value in given.given.items()
             if name not in _OF_THE_START]
    start.told['resume'] = shlex.join([*words, *shown])
    start.told['begin_again'] = shlex.join([*words, *every])


def _land(start: Start) -> None:
    start.told['partial'] = ''
    if 'output' not in start.launch:
        output = new_recording(start.runs / f'landing-{_now()}.rrd')
        start.launch['output'] = str(output)
        start.told['partial'] = str(output.with_name(output.stem + PARTIAL))
    start.told['output'] = start.launch['output']


def _evaluate(start: Start) -> None:
    start.told['made'] = ''
    if start.launch.get('conditions') == ALL and 'output' not in start.launch:
        # A table takes minutes to fly: its figures are kept in files.
        start.launch['output'] = str(new_folder(start.runs / f'conditions-{_now()}'))
        start.told['made'] = start.launch['output']


def _fly(start: Start) -> None:
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise ValueError('standard input: got no terminal, expected one, to fly from')
    given, pilot = start.arguments, []
    for name, value in given.agent.items():
        pilot += ['-p', f'{name}:={str(value).lower()}']
    start.told.update({
        'pilot': pilot, 'output': start.launch.get('output', ''),
        **{name: start.launch.get(name) or given.of_launch(name)
           for name in ('namespace', 'serve_web', 'connect')}})


def _now() -> str:
    return f'{datetime.now():%Y%m%d-%H%M%S}'


def _bash(told: dict[str, str | list[str]]) -> str:
    """Return variables as lines of bash."""
    return ''.join(
        f'{name}={shlex.quote(value)}\n' if isinstance(value, str)
        else f'{name}=({shlex.join(value)})\n' for name, value in told.items())


def run(script: str, pid: int, scratch: Path, texts: Sequence[str]) -> str:
    """Begin a command; return what to print.

    :raises ValueError: naming an argument, what was given and what was expected.
    :raises TypeError: for a value of another kind.
    :raises OSError: when a file or folder cannot be read or made.
    """
    path = Path(script)
    asked = {'-h', '--help'} & set(texts)
    words = [text for text in texts if text not in ('-h', '--help')]
    names = [word for word in words if asked and ':=' not in word]
    found = parse(path.name, path.with_name(f'{path.name}.launch.yaml'), [
        word for word in words if word not in names])
    start = Start(script, pid, scratch, found)
    if not asked:
        prepare(start)
        (scratch / PLAN).write_text(_bash(start.told), 'utf-8')
        return ''
    told = {**decided(start), **_placeholders(start)}
    if names:
        return explanation(names, start.folder, found, told)
    return help_text(script, start.folder, found, told)


def _placeholders(start: Start) -> dict[str, str]:
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
            sys.stdout.write(run(script, int(pid), Path(scratch), texts))
    except (ValueError, TypeError, OSError) as error:
        sys.stderr.write(f'{Path(script).name}: {" ".join(str(error).split())}\n')
        sys.exit(2)


if __name__ == '__main__':
    main()
