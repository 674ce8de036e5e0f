# SPDX-License-Identifier: Apache-2.0
"""The page of the Python API: signatures and docstrings of the public names."""
from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
import textwrap
from collections.abc import Callable
from collections.abc import Iterator
from typing import Any

PUBLIC = {
    'rocket_sim_node.worlds': (
        'make', 'names', 'settings', 'reset_settings', 'full_reach', 'settings_from',
        'stepping_settings', 'SteppingSettings', 'units', 'VectorEnv', 'WorldSpec', 'Episodes',
        'EnvironmentRestarted', 'EnvironmentClosed'),
    'rocket_sim_node.worlds.jobs': ('Fleet', 'SerialFleet'),
    'rocket_sim_node.wire.client.client': ('Client',),
    'rocket_sim_node.wire.client.connection': ('ConnectionOptions',),
    'rocket_sim_node.wire.client.fleet': ('SimulatorFleet',),
    'rocket_sim_node.gym': ('HoverslamVectorEnv', 'HoverslamEnv', 'ReverseCurriculum'),
    'rocket_sim_node.gym.sb3': ('HoverslamVecEnv',),
    'rocket_sim_node.gym.record_rerun': ('RecordRerun',),
    'rocket_sim_node.bags.reader': ('read', 'messages', 'Recorded'),
    'rocket_sim_node.recording.reader': ('trajectories', 'RecordedTrajectory'),
    'ppo_agent_node.config.presets': ('load_preset', 'preset_names'),
    'ppo_agent_node.runs.folder': ('RunFolder',),
    'ppo_agent_node.training.trainer': ('Trainer',),
    'ppo_agent_node.distributed.rendezvous': ('joined',),
    'ppo_agent_node.distributed.run_folder': ('open_folder',),
    'ppo_agent_node.flying.pilot': ('Pilot',),
    'ppo_agent_node.pilots.choice': ('choose', 'Chosen'),
    'ppo_agent_node.pilots.policy': ('PolicyPilot',),
    'ppo_agent_node.nodes.piloting': ('run_pilot',),
    'ppo_agent_node.evaluation.runner': ('evaluate', 'EvaluationResult'),
    'ppo_agent_node.evaluation.metrics': ('summarise', 'table'),
    'ppo_agent_node.evaluation.conditions_table': ('fly_table',),
    'ppo_agent_node.evaluation.optimum.optimiser': ('LandingOptimiser', 'Optimum')}
"""The public names, by module. All other names may change at any time."""
_SUMMARISED = {'RunFolder'}
"""Classes that users only pass to other code. Their methods are left out."""
_WIDTH = 88
_HEAD = """# Python API

This page lists the public names, with shapes, units and errors. All others may change at any time.
Only `rocket_sim_node.wire`, `rocket_sim_node.gym.over_dds` and the two `nodes` packages import
`rclpy`; everything else works without ROS. [The worlds in Python](../tutorials/python.md) and
[your own pilot](../tutorials/own-pilot.md) are the tutorials.
"""


def text() -> str:
    """Return the page."""
    lines = [_HEAD]
    for module, names in PUBLIC.items():
        lines.append(f'## {module}\n')
        for name in names:
            lines += _entry(name, getattr(importlib.import_module(module), name))
    return '\n'.join(lines)


def _entry(name: str, found: Any) -> Iterator[str]:
    """Yield a name's heading, signature, docstring and, for a class, its fields and methods."""
    yield f'### {name}\n'
    if not inspect.isclass(found):
        yield _code(_signature(name, found))
        yield _markdown(found)
        return
    made = '__init__' in vars(found) and not getattr(found, '_is_protocol', False)
    fields = dataclasses.is_dataclass(found)
    yield _code(f'class {name}' if fields or not made else _signature(
        f'class {name}', found.__init__))
    yield _markdown(found)
    if made and not fields and (said := _parameters(found.__init__)):
        yield said
    if fields:
        yield _fields(found)
    if name in _SUMMARISED:
        return
    for each, member in vars(found).items():
        function = member.__func__ if isinstance(member, classmethod | staticmethod) else member
        if each.startswith('_') or not (
                inspect.isfunction(function) or hasattr(function, 'func')
                or isinstance(function, property)):
            continue
        if inspect.isfunction(function):
            yield _code(_signature(f'{name}.{each}', function))
        else:
            yield f'`{name}.{each}`\n'
        yield _markdown(function)


def _signature(name: str, function: Callable[..., object]) -> str:
    """Return a name with its parameters, as they are written; one a line if they are many."""
    signature = inspect.signature(function)
    shown = []
    keyword = False
    for each in signature.parameters.values():
        if each.name in ('self', 'cls'):
            continue
        if each.kind is each.KEYWORD_ONLY and not keyword:
            keyword = True
            shown.append('*')
        stars = {each.VAR_POSITIONAL: '*', each.VAR_KEYWORD: '**'}.get(each.kind, '')
        keyword |= stars == '*'
        kind = '' if each.annotation is each.empty else f': {each.annotation}'
        default = '' if each.default is each.empty else f' = {_value(each.default)}'
        shown.append(f'{stars}{each.name}{kind}{default}')
    back = signature.return_annotation
    end = '' if back in (signature.empty, 'None') else f' -> {back}'
    line = f'{name}({", ".join(shown)}){end}'
    if len(line) <= _WIDTH:
        return line
    return f'{name}(\n' + ''.join(f'    {each},\n' for each in shown) + f'){end}'


def _value(value: object) -> str:
    """Return a default as code; dots for a function, which has an address, and a long value."""
    shown = repr(value)
    return '...' if callable(value) or len(shown) > _WIDTH // 2 else shown


def _code(code: str) -> str:
    return f'```python\n{code}\n```\n'


def _parameters(function: object) -> str:
    """Return what a constructor's docstring says of its parameters and errors."""
    said = _markdown(function)
    return said[said.index('- '):] if '\n- ' in f'\n{said}' else ''


def _markdown(found: object) -> str:
    """Return a docstring as Markdown: its fields, such as `:param seed:`, become a list."""
    lines: list[str] = []
    for line in (inspect.getdoc(found) or '').splitlines():
        line = re.sub(r':(?:class|func):(`\w+`)', r'\1', line)
        line = re.sub(r'^:return: *', '- returns: ', line)
        match = re.match(r':(param|raises) (\w+): *(.*)', line)
        if match and match[1] == 'param':
            lines.append(f'- `{match[2]}`: {match[3]}')
        elif match:
            lines.append(f'- raises `{match[2]}`: {match[3]}')
        elif line.startswith(('>>>', '...')):
            lines.append(f'    {line}')
        else:
            lines.append(f'  {line.strip()}' if line.startswith('    ') else line)
    return '\n'.join([*lines, ''])


def _fields(found: type) -> str:
    """Return the fields of a dataclass as code, each beneath what is said of it."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(found))).body[0]
    assert isinstance(tree, ast.ClassDef)
    lines = []
    for node in tree.body:
        if isinstance(node, ast.AnnAssign):
            lines.append(ast.unparse(node))
        elif lines and isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            said = ' '.join(str(node.value.value).split())
            lines[-1:-1] = textwrap.wrap(
                said, _WIDTH, initial_indent='# ', subsequent_indent='# ')
        elif isinstance(node, ast.FunctionDef):
            break
    return _code('\n'.join(lines))
