# SPDX-License-Identifier: Apache-2.0
"""Nodes of another machine are found only if the discovery range allows it."""
from __future__ import annotations

import json
import os
import socket
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml
from support.network import intruder
from support.network.hosts import Hosts
from support.processes import Process
from support.processes import Processes
from support.processes import wait_until

from rocket_sim_node.wire.distributions import fast_dds

RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
ROOT = Path(__file__).parents[3]
LOOK = 4.0
"""s that the intruder looks and tries; where it may see something it takes a second"""
NODES = [
    ('rocket_sim_node', 'simulator'), ('rocket_sim_node', 'rerun_recorder'),
    *(('ppo_agent_node', name) for name in (
        'ppo_agent', 'expert_pilot', 'random_pilot', 'keyboard_pilot', 'evaluate', 'watch',
        'action_server'))]
TERMINAL = (
    'python', '-c', 'import pty, signal, sys; signal.signal(signal.SIGHUP, signal.SIG_DFL); '
    'pty.spawn(sys.argv[1:])')
"""what runs a program in a terminal, which hangs up as soon as this ends"""
STAND_IN = os.environ.get('ROS_DISTRO') == os.environ.get('HOVERSLAM_WHEELS')
"""whether the command ros2 is that of launch_scripts/ros2"""


def listening(process: Process) -> list[tuple[str, str, int]]:
    """Return protocol, address and port of all UDP ports and waiting TCP ports of a process.

    All those of its host are returned: on the hosts of a test there is no other process.
    """
    def host(pid: object) -> str:
        return os.readlink(f'/proc/{pid}/ns/net')

    wait_until(lambda: host(process.pid) != host('self'), 10.0, process.output)
    found = []
    for name in ('udp', 'udp6', 'tcp', 'tcp6'):
        table = Path(f'/proc/{process.pid}/net/{name}')
        for line in table.read_text().splitlines()[1:] if table.exists() else []:
            fields = line.split()
            if name.startswith('udp') or fields[3] == '0A':
                address, port = fields[1].split(':')
                if len(address) == 8:
                    address = socket.inet_ntoa(bytes.fromhex(address)[::-1])
                found.append((name[:3], address, int(port, 16)))
    return found


def places(found: list[tuple[str, str, int]]) -> set[tuple[str, str]]:
    """Return protocols and addresses of ports."""
    return {(protocol, address) for protocol, address, _ in found}


def start_bound(hosts: Hosts, *command: str) -> None:
    """Start a node without a range on host 0 and see that it is bound to its machine."""
    node = hosts.on(0, **{RANGE: None}).start(*command)
    # One for discovery and one for data; what looks for free ports has one at a time.
    wait_until(lambda: len(listening(node)) > 1 or not node.running, 60.0, node.output)
    assert places(listening(node)) == {('udp', '127.0.0.1')}, hosts.logs()


def result(process: Process) -> dict[str, Any]:
    """Return what a program found, its last line."""
    assert process.wait(90.0) == 0, process.output()
    return json.loads(process.output().splitlines()[-1])


def intrude(hosts: Hosts, spoken_to: str | None) -> tuple[dict, dict, set]:
    """Fly on host 0 in a range, None: not set; intrude from host 1.

    :return: what the intruder found, what the pilot did, and where the simulator's host listens.
    """
    one = {RANGE: spoken_to, fast_dds()[0].variables[0]: None}
    simulator = hosts.on(0, **one).run_node(
        'rocket_sim_node', 'simulator', num_envs=intruder.N, agent_lease=100.0)
    go = hosts.folder / 'go'
    flown = hosts.on(0, **one).start('python', intruder.__file__, 'pilot', str(go))
    flown.wait_for('flying', 60.0)
    found = listening(simulator)
    program = hosts.on(1, ROS_STATIC_PEERS=hosts.address(0)).start(
        'python', intruder.__file__, 'intruder', str(LOOK),
        *(str(port) for protocol, _, port in found if protocol == 'udp'))
    seen = result(program)
    go.touch()
    return seen, result(flown), places(found)


def test_another_host_cannot_see_or_control_nodes(hosts: Hosts) -> None:
    seen, flown, ports = intrude(hosts, None)
    assert seen == {'nodes': [], 'publishers': 0, 'heard': 0, 'answers': 0}, hosts.logs()
    assert flown == {'steps': 40, 'equal': True}, hosts.logs()
    assert ports == {('udp', '127.0.0.1')}


def test_with_a_wider_range_another_host_sees_nodes_and_is_answered(hosts: Hosts) -> None:
    """Without this test, the one above would prove nothing. The agent keeps control."""
    seen, flown, ports = intrude(hosts, 'SUBNET')
    assert {'simulator', 'pilot'} <= set(seen['nodes']), hosts.logs()
    assert min(seen['publishers'], seen['heard'], seen['answers']) > 0, hosts.logs()
    assert flown == {'steps': 40, 'equal': True}, hosts.logs()
    assert ('udp', '0.0.0.0') in ports


@pytest.mark.parametrize(('package', 'executable'), NODES)
def test_nodes_started_without_a_range_are_bound_to_this_machine(
        hosts: Hosts, package: str, executable: str) -> None:
    given = (
        ('--ros-args', '-p', f'run_dir:={hosts.folder}/run') if executable == 'ppo_agent' else ())
    terminal = TERMINAL if executable == 'keyboard_pilot' else ()
    start_bound(hosts, *terminal, 'ros2', 'run', package, executable, *given)


@pytest.mark.skipif(not STAND_IN, reason='the ros2 command of a full ROS 2')
def test_the_ros2_command_is_bound_to_this_machine(hosts: Hosts) -> None:
    start_bound(hosts, 'ros2', 'topic', 'echo', '/world', 'rocket_msgs/msg/World')


@pytest.mark.parametrize('host', ['127.0.0.1', '0.0.0.0'])
def test_the_web_page_is_bound_to_this_machine_by_default(
        hosts: Hosts, host: str) -> None:
    given = {} if host == '127.0.0.1' else {'web_host': host}
    recorder = hosts.on(0, **{RANGE: None}).run_node(
        'rocket_sim_node', 'rerun_recorder', serve_web=True, **given)
    recorder.wait_for('watch it in a browser', 60.0)
    assert places(listening(recorder)) == {('udp', '127.0.0.1'), ('tcp', host)}, hosts.logs()


def test_every_command_has_this_machine_as_its_default() -> None:
    """All commands get their environment from one place, and no launch file sets another."""
    folder = ROOT / 'launch_scripts'
    env = {name: value for name, value in os.environ.items() if name != RANGE}
    done = subprocess.run(
        ['bash', '-c', f'. {folder}/env.sh && echo "${RANGE}"'], env=env, check=True,
        capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == ['LOCALHOST']
    commands = [
        path for path in folder.iterdir() if path.is_file() and os.access(path, os.X_OK)]
    assert len(commands) > 5
    for path in commands:
        if path.name != 'setup':
            assert '. "$here/env.sh"' in path.read_text(), path
    texts = {path: path.read_text() for path in folder.rglob('*') if path.suffix in (
        '.yaml', '.sh', '.py', '') and path.is_file()}
    assert [path.name for path, text in texts.items() if RANGE in text] == ['env.sh']
    launch_files = [*folder.parent.glob('*/launch/*.launch.yaml')]
    assert len(launch_files) == 5
    for path in launch_files:
        entries = yaml.safe_load(path.read_text())['launch']
        for entry in entries:
            assert 'set_env' not in entry, path
            entries += entry.get('group', [])


def test_a_bad_profile_stops_every_node_before_it_starts(
        processes: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    profile = tmp_path / 'mine.xml'
    profile.write_text('<dds xmlns="http://www.eprosima.com">\n<profile/>\n</dds>\n')
    monkeypatch.setenv(fast_dds()[0].variables[0], str(profile))
    started = [processes.run_node(package, executable) for package, executable in NODES]
    if STAND_IN:
        started.append(processes.start('ros2', 'topic', 'list'))
    for node in started:
        assert node.wait(60.0) == 2, processes.logs()
        assert f"{profile}:2: Element 'profile'" in node.output()
        assert 'Traceback' not in node.output()
