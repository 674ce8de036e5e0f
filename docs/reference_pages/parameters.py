# SPDX-License-Identifier: Apache-2.0
"""The page of all parameters, from the declarations of the settings."""
from __future__ import annotations

from collections.abc import Iterable

from ppo_agent_node.config import training_config
from ppo_agent_node.config.presets import preset_names
from ppo_agent_node.config.presets import preset_values
from ppo_agent_node.nodes import evaluate
from ppo_agent_node.nodes import keyboard_pilot
from ppo_agent_node.nodes import piloting
from ppo_agent_node.nodes.agent import inference
from ppo_agent_node.nodes.agent import modes
from ppo_agent_node.nodes.agent import training
from ppo_agent_node.nodes.flights import connection
from ppo_agent_node.pilots import keyboard
from rocket_sim_node import worlds
from rocket_sim_node.nodes import bag_recorder
from rocket_sim_node.nodes import rerun_recorder
from rocket_sim_node.nodes import ros_bridge
from rocket_sim_node.nodes import simulation
from rocket_sim_node.recording.trajectories.filter import RecordingFilter
from rocket_sim_node.settings import SettingInfo
from rocket_sim_node.settings import describe

_HEAD = """# Parameters of all nodes

Set a parameter with `--ros-args -p name:=value`. All parameters are read-only after start. If a
name is unknown, or a value has the wrong type or is out of range, the node ends with status 2 and
an error that names it. Relative paths are relative to the folder in which the node was started.
"""
_PRESETS = """Values that you give override those of the preset, which override the
defaults above. These tables list the values of the presets that differ from the defaults.
"""


def table(title: str, infos: Iterable[SettingInfo]) -> str:
    """Return a heading and a Markdown table of settings."""
    return f'## {title}\n\n{rows(infos)}'


def rows(infos: Iterable[SettingInfo]) -> str:
    """Return a Markdown table of settings."""
    lines = ['| name | type | default | range | meaning |', '| --- | --- | --- | --- | --- |']
    lines += [
        f'| `{info.name}` | {_kind(info)} | {_value(info.default)} | {limits(info)} '
        f'| {_escaped(info.description)}{f", {info.unit}" if info.unit else ""} |'
        for info in infos]
    return '\n'.join([*lines, ''])


def presets(world: str) -> str:
    """Return a heading and a Markdown table of what the presets of a world set."""
    defaults = {info.name: info.default for info in training_config.describe()}
    names = sorted(preset_names(world), key=lambda name: (name != 'default', name))
    values = [{
        name: tuple(value) if isinstance(value, list) else value
        for name, value in preset_values(preset, world).items()} for preset in names]
    lines = [f'### Presets of `{world}`', '', f'| name | {" | ".join(names)} |',
             f'| --- |{" --- |" * len(names)}']
    for name, default in defaults.items():
        cells = [
            _value(found[name]) or "`''`" if found.get(name, default) != default else ''
            for found in values]
        if any(cells):
            lines.append(f'| `{name}` | {" | ".join(cells)} |')
    return '\n'.join([*lines, ''])


def _escaped(text: str) -> str:
    """Return a text with its bars, which would end a cell of the table."""
    return text.replace('|', r'\|')


def _kind(info: SettingInfo) -> str:
    if isinstance(info.default, tuple):
        return 'list of int'
    return type(info.default).__name__.replace('str', 'string').replace('float', 'double')


def _value(value: object) -> str:
    if isinstance(value, tuple):
        return f'`{list(value)}`'
    if isinstance(value, bool):
        return f'`{str(value).lower()}`'
    return f'`{value:.9g}`' if isinstance(value, float) else f'`{value}`' if value != '' else ''


def limits(info: SettingInfo) -> str:
    """Return the values that a setting may have; empty: any of its type."""
    if info.choices:
        return ', '.join(choice or "`''`" for choice in info.choices)
    if isinstance(info.default, bool | str):
        return ''
    return f'{_bound(info.low)} to {_bound(info.high)}'


def _bound(value: float) -> str:
    return '2**62' if value == 2**62 else f'{value:.10g}'


def text() -> str:
    """Return the page."""
    return '\n'.join([
        _HEAD,
        table('`simulator`', (
            *describe(simulation.SimulatorParameters), *describe(worlds.SteppingSettings))),
        *(table(f'`simulator`, `world:={name}`', worlds.settings(name))
          for name in worlds.names()),
        table('`rerun_recorder`', (
            *describe(rerun_recorder.Destinations), *describe(RecordingFilter))),
        table('`bag_recorder`', describe(bag_recorder.BagParameters)),
        table('`ros_bridge`', describe(ros_bridge.BridgeParameters)),
        table('`ppo_agent`', describe(modes.AgentParameters)),
        table('`ppo_agent`, mode `train`', (
            *describe(training.TrainingParameters), *training_config.describe())),
        _PRESETS, *(presets(name) for name in worlds.names()),
        table('`ppo_agent`, mode `infer`', describe(inference.InferenceParameters)),
        table('`expert_pilot` and `random_pilot`', describe(piloting.PilotParameters)),
        table('`keyboard_pilot`', (
            *describe(keyboard_pilot.KeyboardParameters), *describe(keyboard.KeyboardSettings))),
        table('`evaluate`', describe(evaluate.EvaluationParameters)),
        table(
            'All nodes of `ppo_agent_node` but `watch` and `action_server`',
            describe(connection.ConnectionParameters)),
    ])

