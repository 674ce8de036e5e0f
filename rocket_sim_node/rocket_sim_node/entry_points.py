# SPDX-License-Identifier: Apache-2.0
"""The programs of this package: each runs a node, or tells which module it lacks."""
from __future__ import annotations

import importlib
import os
import signal
import sys

_EXTRAS = {
    'foxglove': 'foxglove', 'rerun': 'recording', 'pyarrow': 'recording', 'mcap': 'bags',
    'yaml': 'bags', 'lxml': 'ros'}
"""extras of this package that bring a module"""
_FROM_PIP = ('torch', 'rich', 'scipy', 'matplotlib', 'safetensors', 'clarabel', 'onnxruntime')
"""modules that pip installs under their own name"""


def run(module: str) -> None:
    """Run `main` of a node's module.

    pip installs the programs where there is no ROS 2 as well. There, the process ends with a line
    that names the missing module, and status 2.

    :param module: such as `rocket_sim_node.nodes.simulator`.
    """
    _open_streams()
    try:
        _end_on_signals()
        importlib.import_module(module).main()
    except ModuleNotFoundError as error:
        missing = (error.name or '').partition('.')[0]
        if not missing or missing == module.partition('.')[0]:
            raise
        name = module.rpartition('.')[2]
        sys.stderr.write(f'{name}: module {missing!r} is missing; {_advice(missing)}\n')
        sys.exit(2)


def _end_on_signals() -> None:
    """Let SIGINT and SIGTERM end the process without a traceback until `main` handles them."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda *_: os._exit(0))


def _open_streams() -> None:
    """Open /dev/null as each standard stream that is closed.

    The next file that is opened would take its number, and receive what libraries print.
    """
    for number, (name, mode) in enumerate((('stdin', 'r'), ('stdout', 'w'), ('stderr', 'w'))):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)  # the lowest number: those below are open
            os.set_inheritable(opened, True)
            setattr(sys, name, os.fdopen(opened, mode))


def _advice(missing: str) -> str:
    if missing in _EXTRAS:
        return f"pip install 'rocket_sim_node[{_EXTRAS[missing]}]'"
    if missing in _FROM_PIP:
        return f'pip install {missing}'
    return (
        'nodes need ROS 2 and the workspace: source both, or run ./launch_scripts/setup of the '
        'repository; without ROS 2 use rocket_sim_node.worlds or rocket_sim_node.gym')


def simulator() -> None:
    """Run node `simulator`."""
    run('rocket_sim_node.nodes.simulator')


def rerun_recorder() -> None:
    """Run node `rerun_recorder`."""
    run('rocket_sim_node.nodes.rerun_recorder')


def bag_recorder() -> None:
    """Run node `bag_recorder`."""
    run('rocket_sim_node.nodes.bag_recorder')


def ros_bridge() -> None:
    """Run node `ros_bridge`."""
    run('rocket_sim_node.nodes.ros_bridge')
