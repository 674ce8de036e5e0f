# SPDX-License-Identifier: Apache-2.0
"""Start-up and shutdown of a node's process."""
from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import ExitStack
from contextlib import suppress
from typing import Any
from typing import NoReturn
from typing import TypeAlias

from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.executors import ExternalShutdownException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_rmw_implementation_identifier
from rclpy.utilities import remove_ros_args

from rocket_sim_node import ros_environment
from rocket_sim_node.errors import EnvironmentClosed
from rocket_sim_node.wire.dds import security
from rocket_sim_node.wire.dds.profile import ProfileError
from rocket_sim_node.wire.dds.transport import TransportError
from rocket_sim_node.wire.dds.transport import prepared
from rocket_sim_node.wire.distributions import initialised
from rocket_sim_node.wire.node import clock_steps
from rocket_sim_node.wire.node import stopping
from rocket_sim_node.wire.node.polling import PolledEntity

USAGE_ERROR = 2

Body: TypeAlias = Callable[[Node, Executor], 'int | None']
"""Main function of a node; may return an exit status."""
Errors: TypeAlias = tuple[type[Exception], ...]


class UsageError(ValueError):
    """The node was started with an invalid combination of arguments."""


def make_executor(context: Context | None = None) -> Executor:
    """Return the fastest available executor, for `spin_once` with a finite time-out.

    The events executor does not rebuild a wait set for each message; older releases lack it.
    A step of the system clock does not prolong its waits, see `clock_steps`.
    """
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        executor: Executor = SingleThreadedExecutor(context=context)
    else:
        executor = EventsExecutor(context=context)
    clock_steps.WATCH.add(executor, clock_steps.wake_executor)
    return executor


def _make_node(name: str) -> Node:
    try:
        return Node(name, automatically_declare_parameters_from_overrides=True)
    except ValueError as error:
        # rclpy does not accept empty lists, and its error does not name the parameter.
        raise UsageError(
            f'a parameter could not be read, perhaps an empty list: {error}') from error


def run(
    name: str, body: Body, expected: Errors = (), args: list[str] | None = None,
) -> int:
    """Run a node until `body` returns; return the exit status.

    SIGINT, SIGTERM and SIGHUP only set a flag (see `stopping`), which a waiting body must check.

    :param body: called with the node and its executor.
    :param expected: errors reported in one line, without a traceback, with status 2.
    """
    return run_late(name, lambda: (body, ()), expected, args)


def run_late(
    name: str, load: Callable[[], tuple[Body, Errors]], expected: Errors = (),
    args: list[str] | None = None,
) -> int:
    """Run a node as :func:`run` does, and import its body while the node is being discovered.

    DDS takes a large part of a second until existing participants know a new one. A node that
    exists before it imports a world, or PyTorch, can communicate as soon as it is ready. If it is
    asked to stop meanwhile, it exits with status 0.

    :param load: imports and returns the body and further expected errors.
    :param expected: errors that are known without an import and may occur before the body runs.
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
                f'unknown argument {stray[0]!r}, expected: --ros-args -p name:=value'))
        stopping.listen()
        try:
            ros_environment.check(os.environ)
            ros_environment.complete(os.environ)
        except ValueError as error:
            return fail(None, error)
        security.require(name, sys.argv if args is None else args)
        with ExitStack() as stack:
            with prepared(get_rmw_implementation_identifier()):
                stack.enter_context(initialised(
                    args=args, signal_handler_options=SignalHandlerOptions.NO))
                node = _make_node(name)
            try:
                body, further = stopping.abandonable(load)
                caught = (*caught, *further)
                executor = make_executor()
                executor.add_node(node)
                return body(node, executor) or 0
            finally:
                # Before `leave`, which skips clean-up, so that peers notice the departure.
                if executor is not None:
                    executor.remove_node(node)
                PolledEntity.destroy_all(node)
                node.destroy_node()
    except (ExternalShutdownException, EnvironmentClosed):
        return 0
    except caught as error:
        return fail(node, error)
    except RuntimeError as error:
        if node is not None:
            raise
        # Raised by rclpy for arguments that it cannot parse.
        return fail(None, error)


def leave(status: int) -> NoReturn:
    """End this process at once, after `run`.

    Python's normal exit would first collect all objects of all libraries; with a learner loaded
    that takes a second, or several on a busy machine. It would also remove our signal handlers
    first, so a second Ctrl-C at that moment would look like a crash.
    """
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):  # the reader has closed the stream
            stream.flush()
    os._exit(status)
