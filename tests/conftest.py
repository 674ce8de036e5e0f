# SPDX-License-Identifier: Apache-2.0
"""Fixtures for tests that start processes or speak over DDS."""
from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck
from hypothesis import settings
from hypothesis.configuration import set_hypothesis_home_dir
from support.network.hosts import Hosts
from support.network.hosts import missing
from support.processes import Processes
from support.users.pseudo_terminal import PseudoTerminal

# Before any test imports torch: torch reads the number of its threads and how they wait, which
# this package sets, only once. Else the workers' threads spin for each other's cores, and a small
# network takes 80 times as long.
import ppo_agent_node  # noqa: F401


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of `launch_scripts/test`."""
    parser.addoption(
        '--nightly', action='store_true', help='faults at least 50 times each, and long runs')
    parser.addoption(
        '--fast', action='store_true',
        help='fewer examples for each property; say what launch_scripts/test --fast leaves out')


def pytest_configure(config: pytest.Config) -> None:
    """Choose how thoroughly properties are tried: always the same examples, or many others."""
    # Hypothesis keeps its files outside of the repository, and no examples.
    home = tempfile.TemporaryDirectory(prefix='hoverslam-tests-')
    config.add_cleanup(home.cleanup)
    set_hypothesis_home_dir(home.name)
    # Else stable-baselines3 leaves a folder of its own in /tmp for each learner.
    os.environ['SB3_LOGDIR'] = home.name
    suite = settings(
        derandomize=True, database=None, deadline=None, print_blob=True, max_examples=50,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
    settings.register_profile('suite', suite)
    settings.register_profile('nightly', suite, derandomize=False, max_examples=5000)
    settings.register_profile('fast', suite, max_examples=20)
    chosen = [name for name in ('nightly', 'fast') if config.getoption(f'--{name}')]
    settings.load_profile(chosen[0] if chosen else 'suite')


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Say what a fast run has left out."""
    if config.getoption('--fast'):
        terminalreporter.write_line(
            'fast: left out are unit tests marked slow and all of tests/node and tests/system, '
            'which need DDS; ./launch_scripts/test runs them')


@pytest.fixture(scope='session')
def nightly(request: pytest.FixtureRequest) -> bool:
    """Whether there is time for many rounds."""
    return bool(request.config.getoption('--nightly'))


@pytest.fixture(scope='session')
def nightly_only(nightly: bool) -> None:
    """Skip what there is no time for."""
    if not nightly:
        pytest.skip('takes minutes; ./launch_scripts/test --nightly runs it')


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Any:
    """Keep the outcome where fixtures can see it, and show the nodes' logs when a test fails."""
    report = yield
    if report.failed:
        used = getattr(item, 'funcargs', {})
        for name in ('processes', 'hosts'):
            if name in used:
                report.sections.append(('logs of the nodes', used[name].logs()))
        if 'terminal' in used:
            report.sections.append(('the terminal', used['terminal'].text))
    return report


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Processes]:
    """Processes that end with the test."""
    group = Processes(tmp_path)
    yield group
    group.end()


@pytest.fixture
def hosts(tmp_path: Path) -> Iterator[Hosts]:
    """Two hosts, where there can be some."""
    if why := missing():
        pytest.skip(why)
    made = Hosts(tmp_path)
    yield made
    made.end()


@pytest.fixture
def terminal() -> Iterator[PseudoTerminal]:
    """A terminal."""
    terminal = PseudoTerminal()
    yield terminal
    terminal.close()


@pytest.fixture
def make_node(
    processes: Processes, monkeypatch: pytest.MonkeyPatch,
) -> Iterator[Callable[..., Any]]:
    """Nodes in the domain of this test and their executors, each in a context of its own."""
    import rclpy
    from rclpy.context import Context
    from rclpy.executors import Executor
    from rclpy.node import Node

    from rocket_sim_node.wire.node.polling import PolledEntity
    from rocket_sim_node.wire.node.running import make_executor

    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    contexts, nodes = [], []

    def make(namespace: str = '', **options: Any) -> tuple[Node, Executor]:
        context = Context()
        rclpy.init(context=context, domain_id=processes.domain)
        contexts.append(context)
        node = Node('tester', context=context, namespace=namespace, **options)
        executor = make_executor(context)
        executor.add_node(node)
        nodes.append(node)
        return node, executor

    yield make
    for node in nodes:
        PolledEntity.destroy_all(node)
    for context in contexts:
        rclpy.shutdown(context=context)


@pytest.fixture
def make_client(make_node: Callable[..., Any]) -> Callable[..., Any]:
    """Clients of the simulators of this test."""
    from rocket_sim_node.wire.client.client import Client
    from rocket_sim_node.wire.client.connection import ConnectionOptions

    def make(agent: int | None = None, namespace: str = '', **options: float) -> Client:
        options = {'resend_after': 0.1, 'patience': 15.0, **options}
        return Client(*make_node(namespace), ConnectionOptions(**options), agent)

    return make
