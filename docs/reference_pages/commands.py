# SPDX-License-Identifier: Apache-2.0
"""The page of commands, from their argument parsers and help texts."""
from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from collections.abc import Iterable
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from unittest import mock

from ppo_agent_node.commands import arguments
from ppo_agent_node.commands import compare
from ppo_agent_node.commands import export
from ppo_agent_node.commands import failures
from ppo_agent_node.commands import launch
from ppo_agent_node.commands import pictures
from ppo_agent_node.commands import report
from ppo_agent_node.commands.argument_help import PURPOSE
from ppo_agent_node.commands.launch_file import LaunchArgument
from ppo_agent_node.commands.launch_file import resolved
from ppo_agent_node.nodes import evaluate
from ppo_agent_node.nodes.agent import inference
from ppo_agent_node.nodes.agent import training
from ppo_agent_node.pilots.keyboard import StartSettings
from reference_pages.parameters import limits
from reference_pages.parameters import rows
from rocket_sim_node import worlds
from rocket_sim_node.nodes import rerun_recorder
from rocket_sim_node.nodes import simulation
from rocket_sim_node.recording import screenshot
from rocket_sim_node.settings import SettingInfo
from rocket_sim_node.settings import describe

ROOT = Path(__file__).parents[2]
SCRIPTS = ROOT / 'launch_scripts'
LAUNCH_FILES = ROOT / 'ppo_agent_node' / 'launch'
_LAUNCHED = {
    'train': training.TrainingParameters, 'land': inference.InferenceParameters,
    'evaluate': evaluate.EvaluationParameters, 'fly': StartSettings}
"""Commands with a launch file, and parameters of the nodes that they start."""
_SHARED = (simulation.SimulatorParameters, worlds.SteppingSettings, rerun_recorder.Destinations)
_PLAIN: dict[str, tuple[Callable[[], None], type]] = {
    'compare': (compare.main, compare.Comparison),
    'export': (export.main, export.Export),
    'failures': (failures.main, failures.Failures),
    'report': (report.main, report.Options),
    'screenshot': (screenshot.main, screenshot.ScreenshotSettings),
    'pictures': (pictures.main, pictures.Pictures)}
_SHELL = ('bench', 'secure', 'test', 'setup')
"""Commands whose help text is in a bash script."""
_GUIDES = {
    'train': '../how-to/train.md', 'land': '../tutorials/first-landing.md',
    'evaluate': '../how-to/evaluate-and-compare.md', 'fly': '../tutorials/fly-by-hand.md',
    'compare': '../how-to/evaluate-and-compare.md#compare-the-pilots-of-a-run',
    'export': '../how-to/export-a-policy.md',
    'failures': '../how-to/evaluate-and-compare.md#evaluate',
    'report': '../how-to/evaluate-and-compare.md#report',
    'screenshot': '../how-to/watch-and-record.md', 'pictures': '../how-to/watch-and-record.md',
    'bench': '../how-to/bench.md', 'secure': '../how-to/security.md#dds-security',
    'test': '../../CONTRIBUTING.md#tests', 'setup': '../how-to/install.md'}
_MORE = {
    'train': 'It also takes every setting of the [world](parameters.md#simulator-worldrocket) '
             'and of the [agent](parameters.md#ppo_agent-mode-train).',
    'land': 'It also takes every setting of the [world](parameters.md#simulator-worldrocket).',
    'evaluate': 'It also takes every setting of the '
                '[world](parameters.md#simulator-worldrocket).',
    'fly': 'It also takes every setting of the [world](parameters.md#simulator-worldrocket) '
           'and of the [pilot](parameters.md#keyboard_pilot).'}
_HEAD = """# Commands

All commands are in `launch_scripts/`. They first set up what is missing. Most arguments have
the form `name:=value`. `--help` lists the arguments with the defaults that would apply. For
`train`, `land`, `evaluate` and `fly`, `--help NAME …` explains single arguments.
`. launch_scripts/env.sh` activates the environment in a shell, with `ros2`, `rerun` and `python`.

A command refuses an unknown name and suggests the most similar known one. The exit status is 0
when the work is complete, 130 after Ctrl-C, 143 after SIGTERM, and 1 or 2 after an error; a start
that is refused ends with 2 (with a full ROS 2: 1, if a node refuses it). Nodes that `ros2 run`
starts end with 2 after an error, with one line that says what was wrong.
[Guarantees](guarantees.md#commands) lists the guarantees for every command, with their tests.

A parameter file must have parameters for the node that it is given to, under `/**`, `/**/NODE` or
the node's full name. `land`, `evaluate` and `fly` choose a namespace of their own unless
`namespace:=` is given. Input files must be regular files.

The launch files `train.launch.yaml`, `land.launch.yaml`, `evaluate.launch.yaml` and
`fly.launch.yaml`, in `ppo_agent_node/launch`, are plain YAML for `ros2 launch ppo_agent_node`.

"""


def text() -> str:
    """Return the page."""
    parts = {
        **{name: _launched(name) for name in _LAUNCHED},
        **{name: _plain(name) for name in _PLAIN}, **{name: _shell(name) for name in _SHELL}}
    lines = ['| command | purpose |', '| --- | --- |']
    lines += [
        f'| [`{name}`](#{name}) | {what} ([how]({_GUIDES[name]})) |'
        for name, (what, _) in parts.items()]
    sections = [f'## {name}\n\n{section}' for name, (_, section) in parts.items()]
    return _HEAD + '\n'.join([*lines, '', *sections])


def _launched(name: str) -> tuple[str, str]:
    """Return what a command with a launch file does, and its section."""
    found = arguments.parse(name, LAUNCH_FILES / f'{name}.launch.yaml', [])
    start = launch.Start(f'launch_scripts/{name}', 0, Path(), found)
    decisions = {**launch.decided(start), **launch.placeholders(start)}
    values = resolved(found.declared, decisions, Path('ppo_agent_node/launch'))
    known = {info.name: info for info in worlds.settings(worlds.names()[0])}
    for declared in (*_SHARED, _LAUNCHED[name]):
        known |= {info.name: info for info in describe(declared)}
    lines = ['| name | default | range | meaning |', '| --- | --- | --- | --- |']
    lines += [
        f'| `{each.name}` | {f"`{values[each.name]}`" if values[each.name] else ""} '
        f'| {_range(each, known)} | {each.description} |' for each in found.declared.values()]
    what = PURPOSE[name]
    usage = f'    ./launch_scripts/{name} [NAME:=VALUE ...]'
    return what, '\n'.join([what, '', usage, '', *lines, '', _MORE[name], ''])


def _range(argument: LaunchArgument, known: dict[str, SettingInfo]) -> str:
    """Return the values that an argument of a launch may have; empty: any text."""
    if argument.name in arguments.CHOICES:
        return ', '.join(arguments.CHOICES[argument.name])
    if argument.default in ('true', 'false'):
        return 'true, false'
    info = known.get(argument.name)
    if not info:
        return ''
    return f'{limits(info)} {info.unit}'.rstrip()


def _plain(name: str) -> tuple[str, str]:
    """Return what a command of a settings dataclass does, and its section."""
    main, declared = _PLAIN[name]
    with mock.patch.object(sys, 'argv', [name, '--help']), redirect_stdout(StringIO()) as said:
        main()
    usage, what, *_ = said.getvalue().split('\n\n')
    what = ' '.join(what.split())
    return what, '\n'.join([
        what, '', f'    ./launch_scripts/{usage.removeprefix("Usage: ")}', '',
        rows(describe(declared))])


def _shell(name: str) -> tuple[str, str]:
    """Return what a command that is written in bash does, and its section."""
    script = SCRIPTS / name
    shown = subprocess.run(
        [f'./launch_scripts/{name}', '--help'], cwd=ROOT, capture_output=True, text=True,
        check=True, timeout=30.0).stdout.replace(f'{ROOT}/', '').replace(str(ROOT), 'the project')
    return _comment(script.read_text('utf-8').splitlines()), f'```text\n{shown}```\n'


def _comment(lines: Iterable[str]) -> str:
    """Return the first sentence of the comment at the top of a script."""
    words = []
    for line in lines:
        if line.startswith('#') and not line.startswith(('#!', '# SPDX', '# shellcheck')):
            words.append(line.removeprefix('#').strip())
        elif words:
            break
    return ' '.join(words).split('. ')[0].removesuffix('.') + '.'
