# SPDX-License-Identifier: Apache-2.0
"""Carries out the entities of a launch file, as far as the list of processes to start."""
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ros2 import packages
from ros2.errors import CommandError
from ros2.errors import unknown
from ros2.launch import parameters
from ros2.launch.context import Context
from ros2.launch.context import LaunchError
from ros2.launch.context import join_namespaces
from ros2.launch.entity import Entity
from ros2.launch.entity import load
from ros2.launch.substitutions import boolean
from ros2.launch.substitutions import substitute

_OUTPUTS = ('screen', 'log')
_SIGTERM_SECONDS = 5.0


@dataclass(frozen=True)
class ProcessPlan:
    """A process to start: what, and what to do with its output and its end."""

    name: str
    command: tuple[str, ...]
    output: str = 'log'
    shutdown_on_exit: bool = False
    sigterm_timeout: float = _SIGTERM_SECONDS
    """seconds from SIGINT to SIGTERM"""
    respawn_delay: float | None = None
    """seconds from its end to its next start; None: it is started once"""


def carry_out(path: Path, context: Context) -> list[ProcessPlan]:
    """Return the processes that a launch file starts.

    :raises LaunchError: when something in it is wrong.
    """
    context.file = path.absolute()
    plans: list[ProcessPlan] = []
    _run(load(path), context, plans)
    return plans


def _run(entities: list[Entity], context: Context, plans: list[ProcessPlan]) -> None:
    for entity in entities:
        try:
            _ACTIONS[entity.kind](entity, context, plans)
        except LaunchError as error:
            raise error if error.placed else entity.error(str(error)) from None
        except CommandError as error:
            raise entity.error(str(error)) from None


def _arg(entity: Entity, context: Context, plans: list[ProcessPlan]) -> None:
    name = entity.need('name')
    if name in context.arguments:
        return
    default = entity.get('default')
    if default is None:
        raise LaunchError(
            f'Required launch argument "{name}" (description: '
            f'"{entity.get("description") or "no description given"}") was not provided')
    context.arguments[name] = substitute(default, context)


def _push_namespace(entity: Entity, context: Context, plans: list[ProcessPlan]) -> None:
    namespace = substitute(entity.need('namespace'), context)
    context.namespace = join_namespaces(context.namespace, namespace)


def _group(entity: Entity, context: Context, plans: list[ProcessPlan]) -> None:
    _run(entity.children, context.inner(), plans)


def _node(entity: Entity, context: Context, plans: list[ProcessPlan]) -> None:
    condition = entity.get('if')
    if condition is not None and not boolean(substitute(condition, context)):
        return
    package = substitute(entity.need('pkg'), context)
    executable = substitute(entity.need('exec'), context)
    folder = packages.prefix_of(package) / 'lib' / package
    try:
        path = packages.executable(package, executable)
    except CommandError:
        raise LaunchError(
            f"executable '{executable}' not found on the libexec directory '{folder}'") from None
    name = substitute(entity.need('name'), context)
    command = [str(path), '--ros-args', '-r', f'__node:={name}']
    full = '/**'
    if context.namespace:
        full = f'{context.namespace.rstrip("/")}/{name}'
        command += ['-r', f'__ns:={context.namespace}']
    command += parameters.arguments(entity, full, context)
    output = substitute(entity.get('output') or 'log', context)
    if output not in _OUTPUTS:
        raise LaunchError(unknown(f"output '{output}'", _OUTPUTS))
    on_exit = entity.get('on_exit')
    if on_exit not in (None, 'shutdown'):
        raise LaunchError(unknown(f"on_exit '{on_exit}'", ['shutdown']))
    plans.append(ProcessPlan(
        name=f'{Path(executable).name}-{len(plans) + 1}',
        command=tuple(command),
        output=output,
        shutdown_on_exit=on_exit == 'shutdown',
        sigterm_timeout=entity.seconds('sigterm_timeout', _SIGTERM_SECONDS),
        respawn_delay=entity.seconds('respawn_delay', 0.0) if entity.flag('respawn') else None))


_ACTIONS: dict[str, Callable[[Entity, Context, list[ProcessPlan]], None]] = {
    'arg': _arg,
    'push_ros_namespace': _push_namespace,
    'group': _group,
    'node': _node,
}
