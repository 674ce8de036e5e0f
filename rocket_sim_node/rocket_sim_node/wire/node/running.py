# SPDX-License-Identifier: Apache-2.0
"""How the nodes of this system start and end."""
from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import ExitStack
from contextlib import suppress
from typing import Any
from typing import NoReturn
from typing import TypeAlias

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.executors import ExternalShutdownException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_rmw_implementation_identifier
from rclpy.utilities import remove_ros_args

from rocket_sim_node.errors import EnvironmentClosed
from rocket_sim_node.wire.dds import security
from rocket_sim_node.wire.dds import shared_memory_cleanup
from rocket_sim_node.wire.dds.profile import ProfileError
from rocket_sim_node.wire.dds.transport import SharedMemory
from rocket_sim_node.wire.dds.transport import TransportError
from rocket_sim_node.wire.dds.transport import prepared
from rocket_sim_node.wire.node import stopping
from rocket_sim_node.wire.node.inbox import Mailbox

USAGE_ERROR = 2

Body: TypeAlias = Callable[[Node, Executor], 'int | None']
"""What a node does, until it returns; it may return an exit status."""
Errors: TypeAlias = tuple[type[Exception], ...]


class UsageError(ValueError):
    """The node was started in a way that cannot work."""


def make_executor(context: Context | None = None) -> Executor:
    """Return the quickest executor that this ROS 2 has, for `spin_once` with a finite time-out.

    The events executor does not rebuild a wait set for each message; older releases lack it.
    """
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    executor: Executor = EventsExecutor(context=context)
    return executor


def _make_node(name: str) -> Node:
    try:
        return Node(name, automatically_declare_parameters_from_overrides=True)
    except ValueError as error:
        # rclpy knows no empty list, and says so without the name of the parameter.
        raise UsageError(
            f'a parameter could not be read, an empty list perhaps: {error}') from error


def run(
    name: str, body: Body, expected: Errors = (), args: list[str] | None = None,
    shared_memory: SharedMemory = SharedMemory.BOTH_WAYS,
) -> int:
    """Run a node until `body` returns; return the exit status.

    SIGINT, SIGTERM and SIGHUP only ask it to (see `stopping`): a body that waits has to look.

    :param body: gets the node and its executor.
    :param expected: errors that are told in one line, without a traceback, with status 2.
    :param shared_memory: which way the node uses it.
    """
    return run_late(name, lambda: (body, ()), expected, args, shared_memory)


def run_late(
    name: str, load: Callable[[], tuple[Body, Errors]], expected: Errors = (),
    args: list[str] | None = None, shared_memory: SharedMemory = SharedMemory.BOTH_WAYS,
) -> int:
    """Run a node as :func:`run` does, and import what it does while it is being discovered.

    DDS takes a good part of a second until those that were there before know a new participant. A
    node which is there before it imports a world, or PyTorch, exchanges as soon as it is ready.
    When it is told to end meanwhile, it does, with status 0.

    :param load: imports the body and further expected errors, and returns them.
    :param expected: those that are known without an import; they may come before the body, too.
    :param shared_memory: as in :func:`run`.
    """
    def fail(node: Any, error: Exception) -> int:
        if node is not None:
            node.get_logger().fatal(str(error))
        else:
            sys.stderr.write(f'{name}: {error}\n')
        return USAGE_ERROR

    node = None
    executor = None
    caught: Errors = (
        UsageError, ProfileError, TransportError, security.SecurityError, *expected)
    try:
        stray = remove_ros_args(sys.argv if args is None else [name, *args])[1:]
        if stray:
            return fail(None, ValueError(
                f'unknown argument {stray[0]!r}; parameters go as: --ros-args -p name:=value'))
        stopping.listen()
        shared_memory_cleanup.clean()
        security.require(name, sys.argv if args is None else args)
        with ExitStack() as stack:
            with prepared(get_rmw_implementation_identifier(), shared_memory):
                stack.enter_context(
                    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO))
                node = _make_node(name)
            try:
                body, further = stopping.abandonable(load)
                caught = (*caught, *further)
                executor = make_executor()
                executor.add_node(node)
                return body(node, executor) or 0
            finally:
                # Now, not when Python tidies up: peers shall hear that it is gone, see `leave`.
                if executor is not None:
                    executor.remove_node(node)
                Mailbox.destroy_all(node)
                node.destroy_node()
    except (ExternalShutdownException, EnvironmentClosed):
        return 0
    except caught as error:
        return fail(node, error)
    except RuntimeError as error:
        if node is not None:
            raise
        # What rclpy raises for arguments that it cannot read.
        return fail(None, error)


def leave(status: int) -> NoReturn:
    """End this process at once, after `run`.

    Python would first look through all objects of all libraries for what can be freed; with
    those of a learner that takes a second, and several on a busy machine. And it would take back
    our handlers first, so that a second Ctrl-C at that moment would look like a crash.
    """
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):  # nobody reads it any more
            stream.flush()
    os._exit(status)
