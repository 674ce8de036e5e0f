# SPDX-License-Identifier: Apache-2.0
"""Carries out the entries of a launch file, as far as the list of processes to start."""
from __future__ import annotations

import os
import shlex
from collections.abc import Callable
from collections.abc import Iterator
from dataclasses import dataclass
from dataclasses import field
from pathlib import Path

from ros2 import packages
from ros2.errors import CommandError
from ros2.launch import parameters
from ros2.launch.context import Context
from ros2.launch.context import LaunchError
from ros2.launch.context import join_namespaces
from ros2.launch.entity import Entity
from ros2.launch.entity import load
from ros2.launch.substitutions import boolean
from ros2.launch.substitutions import parse
from ros2.launch.substitutions import perform
from ros2.launch.substitutions import substitute

_OUTPUTS = ('screen', 'log', 'both')
_MARK = '\N{OBJECT REPLACEMENT CHARACTER}'


@dataclass(frozen=True)
class ProcessPlan:
    """A process to start: what, and what to do with its output and its end."""

    name: str
    command: tuple[str, ...]
    environment: dict[str, str]
    cwd: str | None = None
    output: str = 'log'
    shutdown_on_exit: bool = False
    respawn: bool = False
    respawn_delay: float = 0.0
    respawn_max_retries: int = -1
    sigterm_timeout: float = 5.0
    sigkill_timeout: float = 5.0


@dataclass
class Plan:
    """What a launch file amounts to."""

    processes: list[ProcessPlan] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)


def carry_out(path: Path, context: Context, plan: Plan) -> None:
    """Carry out a launch file.

    :raises LaunchError: when something in it is wrong.
    """
    context.file = path.absolute()
    run_entities(load(path), context, plan)


def run_entities(entities: list[Entity], context: Context, plan: Plan) -> None:
    """Carry out entries in their order."""
    for entity in entities:
        try:
            if _wanted(entity, context):
                _ACTIONS[entity.kind](entity, context, plan)
        except LaunchError as error:
            raise error if error.placed else entity.error(str(error)) from None
        except CommandError as error:
            raise entity.error(str(error)) from None


def _wanted(entity: Entity, context: Context) -> bool:
    for key in ('if', 'unless'):
        text = entity.get(key)
        if text is not None and boolean(substitute(text, context)) != (key == 'if'):
            return False
    return True


def _arg(entity: Entity, context: Context, plan: Plan) -> None:
    name = entity.need('name')
    if name not in context.arguments:
        default = entity.get('default')
        if default is None:
            raise LaunchError(
                f'Required launch argument "{name}" (description: '
                f'"{entity.get("description") or "no description given"}") was not provided')
        context.arguments[name] = substitute(default, context)
    choices = choices_of(entity)
    if choices and context.arguments[name] not in choices:
        raise LaunchError(
            f'Argument "{name}" provided value "{context.arguments[name]}" is not valid. '
            f'Valid options are: {choices}')


def choices_of(entity: Entity) -> list[str]:
    """Return the values that an argument may have; empty for any."""
    return [str(item.get('value')) for item in entity.items('choice')]


def _let(entity: Entity, context: Context, plan: Plan) -> None:
    context.arguments[entity.need('name')] = substitute(entity.need('value'), context)


def _set_env(entity: Entity, context: Context, plan: Plan) -> None:
    name = substitute(entity.need('name'), context)
    context.environment[name] = substitute(entity.need('value'), context)


def _unset_env(entity: Entity, context: Context, plan: Plan) -> None:
    context.environment.pop(substitute(entity.need('name'), context), None)


def _log(entity: Entity, context: Context, plan: Plan) -> None:
    plan.messages.append(substitute(entity.need('message'), context))


def _push_namespace(entity: Entity, context: Context, plan: Plan) -> None:
    namespace = substitute(entity.need('namespace'), context)
    context.namespace = join_namespaces(context.namespace, namespace)


def _group(entity: Entity, context: Context, plan: Plan) -> None:
    scope = context.inner() if entity.flag('scoped', True) else context
    run_entities(entity.children(), scope, plan)


def _include(entity: Entity, context: Context, plan: Plan) -> None:
    file = context.file
    for name, value in entity.pairs('arg', 'name', 'value'):
        context.arguments[substitute(name, context)] = substitute(value, context)
    carry_out(Path(substitute(entity.need('file'), context)), context, plan)
    context.file = file


def words(text: str, context: Context) -> list[str]:
    """Return the arguments of a command line; what a substitution stands for is never split."""
    values: list[str] = []
    line = ''
    for part in parse(text, keep_escapes=True):
        if isinstance(part, str):
            line += part
        else:
            line += _MARK
            values.append(perform((part,), context))
    try:
        tokens = shlex.split(line)
    except ValueError as error:
        raise LaunchError(f'command line {text!r}: {error}') from None
    following = iter(values)
    return [_replace(token, following) for token in tokens]


def _replace(token: str, values: Iterator[str]) -> str:
    first, *rest = token.split(_MARK)
    return first + ''.join(next(values) + piece for piece in rest)


def _process(entity: Entity, context: Context, plan: Plan, name: str, command: list[str]) -> None:
    output = os.environ.get('OVERRIDE_LAUNCH_PROCESS_OUTPUT') or substitute(
        entity.get('output') or 'log', context)
    if output not in _OUTPUTS:
        raise LaunchError(f"output '{output}' is not one of {', '.join(_OUTPUTS)}")
    on_exit = entity.get('on_exit')
    if on_exit not in (None, 'shutdown'):
        raise LaunchError(f"on_exit '{on_exit}' is not supported, only shutdown")
    environment = dict(context.environment)
    for key, value in entity.pairs('env', 'name', 'value'):
        environment[substitute(key, context)] = substitute(value, context)
    cwd = entity.get('cwd')
    prefix = entity.get('launch-prefix') or context.arguments.get('launch-prefix', '')
    plan.processes.append(ProcessPlan(
        name=f'{name}-{len(plan.processes) + 1}',
        command=(*words(prefix, context), *command),
        environment=environment,
        cwd=None if cwd is None else substitute(cwd, context),
        output=output,
        shutdown_on_exit=on_exit == 'shutdown',
        respawn=boolean(substitute(entity.get('respawn') or 'false', context)),
        respawn_delay=entity.number('respawn_delay', 0.0),
        respawn_max_retries=int(entity.number('respawn_max_retries', -1)),
        sigterm_timeout=entity.number('sigterm_timeout', 5.0),
        sigkill_timeout=entity.number('sigkill_timeout', 5.0)))


def _executable(entity: Entity, context: Context, plan: Plan) -> None:
    command = words(entity.need('cmd'), context)
    if entity.flag('shell', False):
        command = ['/bin/sh', '-c', substitute(entity.need('cmd'), context)]
    name = entity.get('name')
    _process(entity, context, plan, name or Path(command[0]).name, command)


def _node(entity: Entity, context: Context, plan: Plan) -> None:
    executable = substitute(entity.need('exec'), context)
    package = entity.get('pkg')
    path = executable
    if package is not None:
        package = substitute(package, context)
        folder = packages.prefix_of(package) / 'lib' / package
        try:
            path = str(packages.executable(package, executable))
        except CommandError:
            raise LaunchError(
                f"executable '{executable}' not found on the libexec directory '{folder}'",
            ) from None
    own = entity.get('namespace')
    namespace = join_namespaces(
        context.namespace, None if own is None else substitute(own, context))
    command = [path, *words(entity.get('args') or '', context)]
    if entity.get('ros_args') is not None:
        command += ['--ros-args', *words(entity.need('ros_args'), context)]
    command.append('--ros-args')
    name = entity.get('name')
    full = '/**'
    if name is not None:
        name = substitute(name, context)
        command += ['-r', f'__node:={name}']
        if namespace:
            full = f'{namespace.rstrip("/")}/{name}'
    if namespace:
        command += ['-r', f'__ns:={namespace}']
    command += parameters.arguments(entity, full, context)
    for source, target in entity.pairs('remap', 'from', 'to'):
        command += ['-r', f'{substitute(source, context)}:={substitute(target, context)}']
    label = entity.get('exec_name')
    _process(entity, context, plan, label or Path(executable).name, command)


_ACTIONS: dict[str, Callable[[Entity, Context, Plan], None]] = {
    'arg': _arg,
    'let': _let,
    'set_env': _set_env,
    'unset_env': _unset_env,
    'log': _log,
    'push_ros_namespace': _push_namespace,
    'push-ros-namespace': _push_namespace,
    'group': _group,
    'include': _include,
    'executable': _executable,
    'node': _node,
}
