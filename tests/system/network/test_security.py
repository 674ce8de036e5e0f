# SPDX-License-Identifier: Apache-2.0
"""No node runs unsecured when security was requested; and the policy allows what nodes do."""
from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from support.processes import Process
from support.processes import Processes
from support.processes import wait_until
from support.users.pseudo_terminal import PseudoTerminal

from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.dds import security

SCRIPTS = Path(__file__).parents[3] / 'launch_scripts'
NODES = {
    'rocket_sim_node': ('simulator', 'rerun_recorder', 'bag_recorder', 'ros_bridge'),
    'ppo_agent_node': (
        'ppo_agent', 'expert_pilot', 'random_pilot', 'keyboard_pilot', 'evaluate', 'watch',
        'action_server')}
ACTION = {
    'publish': ('feedback', 'status'), 'reply': ('send_goal', 'cancel_goal', 'get_result')}
"""topics and services of an action, below NAME/_action"""
Rule = tuple[str, str]
"""what is done, such as publish, and the name or pattern of what it is done to"""


def allowed() -> dict[str, set[Rule]]:
    """Return the policy's rules by node, as SROS2 makes permissions of them."""
    rules: dict[str, set[Rule]] = {}
    policy = ElementTree.parse(SCRIPTS / 'security' / 'hoverslam.policy.xml')
    for profile in policy.iter('profile'):
        node, prefix = profile.attrib['node'], profile.attrib['ns'].rstrip('/') + '/'
        for group in profile:
            for does in group.attrib:
                for item in group:
                    name = str(item.text).replace('~', prefix + node)
                    rules.setdefault(node, set()).add(
                        (does, name if name.startswith('/') else prefix + name))
    for found in rules.values():
        for action in {name for does, name in found if does == 'execute'}:
            found.remove(('execute', action))
            found |= {
                (does, f'{action}/_action/{name}') for does, names in ACTION.items()
                for name in names}
    return rules


def done(node: Any, name: str, namespace: str) -> set[Rule]:
    """Return what a node does, as the graph shows it."""
    look = {
        'publish': node.get_publisher_names_and_types_by_node,
        'subscribe': node.get_subscriber_names_and_types_by_node,
        'reply': node.get_service_names_and_types_by_node,
        'request': node.get_client_names_and_types_by_node}
    return {(does, topic) for does, names in look.items() for topic, _ in names(name, namespace)}


def covered(rule: Rule, rules: set[Rule]) -> bool:
    """Return whether a rule with a pattern allows something."""
    return any(does == rule[0] and fnmatchcase(rule[1], pattern) for does, pattern in rules)


@pytest.fixture
def terminals() -> Iterator[list[PseudoTerminal]]:
    """Make terminals: in a terminal a node shows more, so it subscribes to more topics."""
    terminals = [PseudoTerminal(), PseudoTerminal(), PseudoTerminal()]
    yield terminals
    for terminal in terminals:
        terminal.close()


@pytest.mark.parametrize('namespace', ['', '/sim_7'])
def test_policy_allows_what_nodes_do_and_nothing_else(
        processes: Processes, make_node: Callable[..., Any], make_client: Callable[..., Client],
        terminals: list[PseudoTerminal], tmp_path: Path, request: pytest.FixtureRequest,
        namespace: str) -> None:
    """A client keeps control: the others have all that they need, and wait."""
    if namespace:  # a unit test compares these rules with the others
        request.getfixturevalue('nightly_only')
    at = ('--ros-args', '-r', f'__ns:={namespace}') if namespace else ('--ros-args',)
    remap = (f'__ns:={namespace}',) if namespace else ()
    processes.run_node('rocket_sim_node', 'simulator', remap, num_envs=1, agent_lease=600.0)
    make_client(namespace=namespace).reset(1)
    processes.run_node('rocket_sim_node', 'rerun_recorder', remap)
    processes.run_node('rocket_sim_node', 'bag_recorder', remap, output=tmp_path / 'bag')
    processes.run_node('rocket_sim_node', 'ros_bridge', remap, clock=True)
    for name in ('expert_pilot', 'random_pilot'):
        processes.run_node('ppo_agent_node', name, remap, patience=100.0)
    processes.fork_node('ppo_agent_node', 'evaluate', remap, patience=100.0)
    processes.run_node('ppo_agent_node', 'action_server', remap)
    env = processes.env
    terminals[0].start(
        'ros2', 'run', 'ppo_agent_node', 'ppo_agent', *at, '-p', f'run_dir:={tmp_path}/run',
        '-p', 'patience:=100.0', env=env)
    terminals[1].start('ros2', 'run', 'ppo_agent_node', 'watch', *at, env=env)
    terminals[2].start('ros2', 'run', 'ppo_agent_node', 'keyboard_pilot', *at, env=env)
    looker, _ = make_node('/looker')
    rules = allowed()
    assert set(rules) == {name for names in NODES.values() for name in names}
    # `ros2 run` and the policy know them by the same names.
    left: dict[str, set[Rule] | None] = dict.fromkeys(rules)

    def all_as_allowed() -> bool:
        for name in list(left):
            try:
                does = done(looker, name, namespace or '/')
            except RuntimeError:  # not there yet
                continue
            here = {
                (kind, pattern) for kind, pattern in rules[name]
                if pattern.startswith('/*') == bool(namespace)
                or pattern in ('/rosout', '/parameter_events', '/diagnostics')}
            left[name] = {
                rule for rule in here if not any(covered(one, {rule}) for one in does)}
            if not left[name]:
                too_much = {one for one in does if not covered(one, rules[name])}
                assert not too_much, f'{name} does what the policy does not allow: {too_much}'
                del left[name]
        return not left

    # Short, and at the end: of long texts a report keeps a part.
    wait_until(all_as_allowed, 100.0, lambda: '\n'.join((
        *(f'--- terminal {number}\n{terminal.text[-1000:]}'
          for number, terminal in enumerate(terminals)),
        f'not done, though allowed (None: not seen): {left}')))


def test_policy_lets_an_agent_fly_simulators_elsewhere(
        processes: Processes, make_node: Callable[..., Any], tmp_path: Path) -> None:
    processes.run_node('rocket_sim_node', 'simulator', ('__ns:=/sim_0',), num_envs=1)
    processes.fork_node(
        'ppo_agent_node', 'ppo_agent', run_dir=tmp_path / 'run', simulators='/sim_*')
    looker, _ = make_node('/looker')
    wanted = ('publish', '/sim_0/action')

    def flies() -> bool:
        try:
            does = done(looker, 'ppo_agent', '/')
        except RuntimeError:
            return False
        rules = allowed()['ppo_agent']
        assert all(covered(one, rules) for one in does), does
        return wanted in does

    wait_until(flies, 60.0, processes.logs)


def has_security() -> bool:
    """Return whether the ROS 2 of this machine has DDS-Security."""
    return security.supported()


def refuses(name: str, process: Process) -> None:
    """Assert that a process ended with one line that says why it does not run unsecured."""
    assert process.wait(60.0) == 2, process.output()
    said, = process.output().splitlines()
    assert said.startswith(f'{name}: security was requested'), said
    assert 'built without DDS-Security' in said
    assert 'launch_scripts/secure, or unset ROS_SECURITY_ENABLE' in said


@pytest.mark.parametrize('strategy', ['Enforce', 'Permissive'])
def test_without_dds_security_nothing_starts(
        processes: Processes, monkeypatch: pytest.MonkeyPatch, strategy: str) -> None:
    if has_security():
        pytest.skip('this ROS 2 has DDS-Security')
    monkeypatch.setenv('ROS_SECURITY_ENABLE', 'true')
    monkeypatch.setenv('ROS_SECURITY_STRATEGY', strategy)
    # One node of each package, in `Permissive`: that is where ROS 2 itself would go on.
    chosen = NODES if strategy == 'Permissive' else {
        package: names[:1] for package, names in NODES.items()}
    started = [
        (name, processes.run_node(package, name))
        for package, names in chosen.items() for name in names]
    for name, node in started:
        refuses(name, node)


@pytest.mark.skipif(
    os.environ.get('ROS_DISTRO') != os.environ.get('HOVERSLAM_WHEELS'),
    reason='the ros2 command of a full ROS 2')
@pytest.mark.parametrize('command', [
    ('topic', 'list'),
    ('service', 'call', '/simulator/reset', 'rocket_msgs/srv/Reset', '{agent: 1}')])
def test_without_dds_security_the_ros2_command_is_refused(
        processes: Processes, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...]) -> None:
    if has_security():
        pytest.skip('this ROS 2 has DDS-Security')
    monkeypatch.setenv('ROS_SECURITY_ENABLE', 'true')
    refuses('ros2', processes.start('ros2', *command))


def test_secure_starts_nothing_without_dds_security(tmp_path: Path) -> None:
    if has_security():
        pytest.skip('this ROS 2 has DDS-Security')
    witness = tmp_path / 'started'
    command = subprocess.run(
        [SCRIPTS / 'secure', 'touch', witness], capture_output=True, text=True, timeout=60,
        check=False)
    assert command.returncode == 2
    assert 'built without DDS-Security' in command.stderr
    assert command.stderr.endswith('secure: nothing was started\n')
    assert not witness.exists()
