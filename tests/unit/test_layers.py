# SPDX-License-Identifier: Apache-2.0
"""Imports between folders run one way, the cores import no ROS, and no folder grows too large."""
from __future__ import annotations

import ast
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ('rocket_sim_node', 'ppo_agent_node')
ROS = {'rclpy', 'rocket_msgs', 'rosidl_runtime_py', 'ament_index_python', 'diagnostic_msgs',
       'service_msgs', 'std_msgs', 'nav_msgs', 'sensor_msgs', 'geometry_msgs', 'tf2_msgs',
       'visualization_msgs', 'rosgraph_msgs', 'simulation_interfaces', 'action_msgs',
       'builtin_interfaces', 'rcl_interfaces', 'std_srvs'}
LATE = {'rocket_sim_node.gym.over_dds'}
"""modules of a core that need ROS, and are imported by name when it is asked for"""
MOST_MODULES = 12
"""in a folder, beside its __init__"""
ROOFS = {'rocket_sim_node.worlds.registry'}
"""modules that hand out what lies in the folders beside them, as an __init__ does"""


def modules() -> dict[str, Path]:
    """Return all modules of the packages, packages included, by dotted name."""
    found = {}
    for package in PACKAGES:
        for path in (ROOT / package / package).rglob('*.py'):
            name = '.'.join(path.relative_to(ROOT / package).with_suffix('').parts)
            found[name.removesuffix('.__init__')] = path
    return found


MODULES = modules()
IS_PACKAGE = {name for name, path in MODULES.items() if path.name == '__init__.py'}


@cache
def imported(path: Path) -> tuple[str, ...]:
    """Return the modules that a file imports, anywhere in it, by their longest known name."""
    return tuple(_imported(path))


def _imported(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                name = f'{node.module}.{alias.name}'
                yield name if name in MODULES else node.module


def room(module: str) -> str:
    """Return the folder of a module; packages and roofs are a room of their own."""
    return f'{module} itself' if module in IS_PACKAGE | ROOFS else module.rpartition('.')[0]


def arrows() -> dict[str, set[str]]:
    """Return which rooms each room imports."""
    found: dict[str, set[str]] = {}
    for module, path in MODULES.items():
        here = found.setdefault(room(module), set())
        here |= {room(name) for name in imported(path) if name in MODULES} - {room(module)}
    return found


def reached(module: str) -> set[str]:
    """Return all that comes with a module: what it imports, and what that imports."""
    seen: set[str] = set()
    todo = [module]
    while todo:
        name = todo.pop()
        if name in seen:
            continue
        seen.add(name)
        if name in MODULES:
            todo += imported(MODULES[name])
            todo += [name.rpartition('.')[0]] if '.' in name else []
    return seen


def test_imports_between_folders_run_one_way() -> None:
    """`prepare` raises CycleError, which names the folders, if they do not."""
    TopologicalSorter(arrows()).prepare()


@pytest.mark.parametrize(('above', 'below'), [
    ('ppo_agent_node.ppo', ('evaluation', 'pilots', 'training', 'imitation', 'nodes')),
    ('ppo_agent_node.imitation', ('evaluation', 'pilots', 'reporting', 'training', 'nodes')),
    ('ppo_agent_node.training', ('evaluation', 'reporting', 'nodes')),
    ('ppo_agent_node.evaluation', ('reporting', 'commands', 'nodes')),
    ('rocket_sim_node.wire', ('recording', 'nodes')),
    ('rocket_sim_node.worlds', ('wire', 'recording', 'nodes')),
    ('rocket_sim_node.telemetry', ('worlds', 'wire', 'recording', 'nodes')),
])
def test_a_folder_imports_no_folder_above_it(above: str, below: tuple[str, ...]) -> None:
    package = above.partition('.')[0]
    for module in MODULES:
        if module.startswith(above):
            for other in below:
                found = [name for name in imported(MODULES[module])
                         if name.startswith(f'{package}.{other}')]
                assert not found, f'{module} imports {found}'


@pytest.mark.parametrize('module', sorted(
    name for name in MODULES.keys() - LATE if '.wire' not in name and '.nodes' not in name))
def test_cores_import_no_ros(module: str) -> None:
    ros = {name for name in reached(module) if name.partition('.')[0] in ROS}
    assert not ros, f'{module} brings {ros}'


def test_nodes_that_need_no_pytorch_start_without_it() -> None:
    """Its import takes seconds of processor time."""
    nodes = 'ppo_agent_node.nodes.action_server, rocket_sim_node.nodes.simulation'
    subprocess.run(
        [sys.executable, '-c', f"import sys, {nodes}; assert 'torch' not in sys.modules"],
        check=True, timeout=60)


def test_no_folder_holds_more_than_a_dozen_modules() -> None:
    listed = subprocess.run(
        ['git', 'ls-files', '--cached', '--others', '--exclude-standard', '*.py'], cwd=ROOT,
        check=True, capture_output=True, text=True).stdout.split()
    paths = [path for name in listed if (path := ROOT / name).exists()]
    counted = Counter(path.parent for path in paths if path.name != '__init__.py')
    assert {str(path): count for path, count in counted.items() if count > MOST_MODULES} == {}


def test_names_of_test_files_are_unique() -> None:
    """Pytest cannot collect two files of the same name together."""
    counted = Counter(path.name for path in (ROOT / 'tests').rglob('test_*.py'))
    assert {name: count for name, count in counted.items() if count > 1} == {}


def test_every_folder_has_a_docstring() -> None:
    for package in IS_PACKAGE:
        if package not in PACKAGES:
            assert ast.get_docstring(ast.parse(MODULES[package].read_text())), package
