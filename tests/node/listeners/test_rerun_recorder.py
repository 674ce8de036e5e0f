# SPDX-License-Identifier: Apache-2.0
"""The recorder as a process: it records a simulator, and leaves complete files."""
from __future__ import annotations

import re
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.request import Request
from urllib.request import urlopen

import numpy as np
import pytest
from rocket_msgs import msg
from support.nodes.falling_rockets import FALL
from support.nodes.falling_rockets import ROCKETS
from support.nodes.falling_rockets import Simulator
from support.processes import Process
from support.processes import Processes
from support.processes import wait_until
from support.recording.recordings import rows_of
from support.recording.recordings import view_classes

from rocket_sim_node.nodes import rerun_recorder
from rocket_sim_node.recording import reader
from rocket_sim_node.recording.drawing import entities
from rocket_sim_node.recording.sinks import rerun_program
from rocket_sim_node.recording.sinks.file_sink import partial_path
from rocket_sim_node.telemetry.samples import Layout
from rocket_sim_node.telemetry.samples import samples_of
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.worlds import make


def start(processes: Processes, path: Path, **parameters: object) -> Process:
    """Start a recorder."""
    recorder = processes.fork_node(
        'rocket_sim_node', 'rerun_recorder', output=path, **parameters)
    recorder.wait_for('recording to', 20.0)
    return recorder


def wait_for_flights(path: Path, count: int) -> None:
    """Wait until the unfinished file at a path has so many flights."""
    def there() -> bool:
        with suppress(OSError, ValueError, IndexError):  # it is being written
            return len(reader.trajectories(partial_path(path))) >= count
        return False

    wait_until(there, 60.0)


@pytest.mark.parametrize('how', [signal.SIGINT, signal.SIGTERM])
def test_the_file_holds_all_flights(
    processes: Processes, simulator: Simulator, tmp_path: Path, how: signal.Signals,
) -> None:
    path = tmp_path / 'run.rrd'
    recorder = start(processes, path)
    simulator.begin()
    simulator.training.publish(msg.TrainingStatus(
        stage='evaluate', iteration=1, landing_rate=0.5, message='evaluation begins'))
    simulator.fall(2 * FALL)
    wait_for_flights(path, 4)
    recorder.signal(how)
    assert recorder.wait(30.0) == 0
    assert 'recording saved' in recorder.output()
    assert 'Traceback' not in recorder.output()
    assert 'write_footer' not in recorder.output()  # Rerun would warn of it
    rerun_program.verify(path)
    flights = reader.trajectories(path)
    assert [(f.row, f.episode, f.outcome) for f in flights] == [
        (0, 0, 'too_fast'), (1, 0, 'too_fast'), (0, 1, 'too_fast'), (1, 1, 'too_fast')]
    for flight in flights:
        assert len(flight.time) == FALL
        assert flight.position[0, 2] == pytest.approx(200.0)
        assert flight.velocity[-1, 2] == pytest.approx(-61.34, abs=0.01)
    assert list(tmp_path.glob('*.rrd')) == [path]


def test_a_world_with_legs_and_terrain(
    processes: Processes, simulator: Simulator, tmp_path: Path,
) -> None:
    path = tmp_path / 'run.rrd'
    recorder = start(processes, path)
    simulator.take('lunar_lander')
    simulator.begin()
    first = simulator.telemetry()
    simulator.fall(250)
    wait_for_flights(path, ROCKETS)
    recorder.signal(signal.SIGTERM)
    assert recorder.wait(30.0) == 0
    assert 'refused' not in recorder.output()
    rerun_program.verify(path)
    assert '2D' in view_classes(path)
    flights = reader.trajectories(path)
    assert len(flights) >= ROCKETS
    grounds = {
        step: np.array(vertices)[1:12, 2]
        for step, vertices in rows_of(path, entities.TERRAIN, 'Mesh3D:vertex_positions')}
    for flight in flights:
        if flight.episode == 0:
            np.testing.assert_allclose(
                grounds[flight.summary['first_step']], first.terrain[flight.row], rtol=1e-6)
            np.testing.assert_allclose(
                flight.position[0, [0, 2]], first.position[flight.row, :2], rtol=1e-6)


@pytest.mark.parametrize('name', ['contact', 'leg_angle', 'terrain', 'contact_force', 'row'])
def test_a_message_that_is_cut_short_is_named(name: str) -> None:
    world = make('lunar_lander', ROCKETS)
    message = conversion.state_to_message(
        np.zeros(ROCKETS, np.uint64), world.telemetry(np.arange(ROCKETS)), 1)
    assert samples_of(message).layout == Layout(legs=2, heights=11)
    setattr(message, name, getattr(message, name)[:-1])
    with pytest.raises(ValueError, match=f'{name}: '):
        samples_of(message)


def test_a_value_that_is_not_finite_is_refused_by_name() -> None:
    world = make('rocket', ROCKETS)
    message = conversion.state_to_message(
        np.zeros(ROCKETS, np.uint64), world.telemetry(np.arange(ROCKETS)), 1)
    message.position[2] = float('nan')
    with pytest.raises(ValueError, match='position: a value is not finite'):
        samples_of(message)


def test_invalid_worlds_and_states_are_ignored(
    processes: Processes, simulator: Simulator, tmp_path: Path,
) -> None:
    path = tmp_path / 'run.rrd'
    recorder = start(processes, path)
    wait_until(lambda: simulator.state.get_subscription_count() > 0, 20.0)
    for name, value, said in (('dt', 0.0, 'dt: got 0.0'), ('outcomes', [], 'number of outcomes')):
        message = conversion.world_to_message(
            make('rocket', ROCKETS).spec, 1, 0, msg.World.LOCKSTEP)
        setattr(message, name, value)
        simulator.description.publish(message)
        recorder.wait_for(f'world ignored: world: {said}', 10.0)
        time.sleep(1.1)  # it says so once a second
    landers = conversion.world_to_message(
        make('lunar_lander', ROCKETS).spec, 1, 0, msg.World.LOCKSTEP)
    simulator.description.publish(landers)
    simulator.state.publish(conversion.state_to_message(
        np.zeros(ROCKETS, np.uint64), simulator.telemetry(), 1))
    recorder.wait_for('contact: for 0 legs, expected 2', 10.0)
    recorder.signal(signal.SIGTERM)
    assert recorder.wait(10.0) == 0
    assert 'Traceback' not in recorder.output()


def test_steps_that_were_not_received_are_reported(
    processes: Processes, simulator: Simulator, tmp_path: Path,
) -> None:
    recorder = start(processes, tmp_path / 'run.rrd')
    simulator.begin()
    simulator.fall(100)
    simulator.skip(30)
    simulator.fall(2 * FALL)
    recorder.wait_for('state: 30 steps before step 131 were not received', 20.0)
    recorder.signal(signal.SIGTERM)
    assert recorder.wait(30.0) == 0
    assert '; 30 steps were not received' in recorder.output()


def test_a_new_recorder_repairs_the_file_of_a_killed_one(
    processes: Processes, simulator: Simulator, tmp_path: Path,
) -> None:
    path = tmp_path / 'run.rrd'
    recorder = start(processes, path)
    simulator.begin()
    simulator.fall(2 * FALL)
    wait_for_flights(path, 1)
    recorder.signal(signal.SIGKILL)
    recorder.wait(5.0)
    assert not path.exists()
    simulator.end()  # a recorder that starts again would receive its description

    again = start(processes, path)
    assert 'its recording is repaired' in again.output()
    rerun_program.verify(path)
    assert 1 <= len(reader.trajectories(path)) <= 4
    again.signal(signal.SIGTERM)
    assert again.wait(30.0) == 0
    assert 'nothing was recorded: ' in again.output()
    assert list(tmp_path.glob('*.rrd')) == [path]


def test_a_recording_has_the_name_of_one(processes: Processes, tmp_path: Path) -> None:
    recorder = processes.fork_node(
        'rocket_sim_node', 'rerun_recorder', output=tmp_path / 'run.txt')
    assert recorder.wait(20.0) == 2
    assert 'expected a name that ends with .rrd' in recorder.output()
    assert not list(tmp_path.glob('run*'))


def test_the_web_page_is_for_this_machine(processes: Processes, tmp_path: Path) -> None:
    port = rerun_program.free_port()
    recorder = processes.fork_node(
        'rocket_sim_node', 'rerun_recorder', serve_web=True, web_port=port)
    recorder.wait_for('watch it in a browser', 25.0)
    with urlopen(f'http://127.0.0.1:{port}/', timeout=5.0) as page:
        assert b'<canvas' in page.read()
    listening = Path('/proc/net/tcp').read_text().splitlines()[1:]
    mine = [line.split()[1] for line in listening if line.split()[1].endswith(f':{port:04X}')]
    assert '00000000' not in {address.split(':')[0] for address in mine}
    data = re.search(r'127\.0\.0\.1%3A(\d+)', recorder.output())
    assert data is not None
    for origin, allowed in (('http://example.org', None), (f'http://127.0.0.1:{port}',) * 2):
        request = Request(
            f'http://127.0.0.1:{data[1]}/', method='OPTIONS',
            headers={'Origin': origin, 'Access-Control-Request-Method': 'POST'})
        with urlopen(request, timeout=5.0) as answer:
            assert answer.headers['Access-Control-Allow-Origin'] == allowed
    recorder.signal(signal.SIGKILL)
    recorder.wait(5.0)
    wait_until(lambda: not rerun_program.reachable('127.0.0.1', port), 5.0)


def test_an_agent_in_another_namespace_is_present_while_it_publishes(
        make_node: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """This is so for the recorders of a fleet: the topic is remapped."""
    monkeypatch.setattr(rerun_recorder, '_AGENT_GONE', 0.1)
    agent, _ = make_node()
    publisher = agent.create_publisher(msg.TrainingStatus, 'training', qos.EVENTS)
    node, _ = make_node(
        '/sim_0', cli_args=['--ros-args', '-r', 'training:=/training'])
    over: list[str] = []
    recorder: Any = SimpleNamespace(training_is_over=lambda: over.append('over'))
    recorder_node = rerun_recorder.RecorderNode(node, recorder)
    wait_until(lambda: bool(node.count_publishers('/training')), 20.0)
    time.sleep(0.3)
    recorder_node.look_after_agents()
    assert not over
    agent.destroy_publisher(publisher)
    wait_until(lambda: recorder_node.look_after_agents() or bool(over), 20.0)
