# SPDX-License-Identifier: Apache-2.0
"""The keyboard pilot as a node, with keys in a pseudo-terminal and a simulator."""
from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rocket_msgs import msg
from support.processes import Process
from support.processes import Processes
from support.processes import wait_until
from support.users.pseudo_terminal import PseudoTerminal

from rocket_sim_node.wire.client.client import Client
from rocket_sim_node.wire.dds import qos

SCRIPTS = Path(__file__).parents[3] / 'launch_scripts'
FLYING = 'arrows lean'
"""what the screen says in flight, and not before"""


@pytest.fixture
def simulator(processes: Processes) -> Process:
    """One rocket by the clock, in slow motion, so that it is still up when a test looks."""
    return processes.run_node(
        'rocket_sim_node', 'simulator', num_envs=1, mode='realtime', realtime_factor=0.5)


def assert_restored(terminal: PseudoTerminal) -> None:
    """Assert that the terminal is as it was; what was written last may still be on its way."""
    wait_until(lambda: terminal.restored, 5.0)


class Looker:
    """Receives the states of the simulator's first vehicle."""

    def __init__(self, client: Client) -> None:
        self.states: list[msg.RocketState] = []
        self.client = client
        client.connect()
        client.node.create_subscription(
            msg.RocketState, 'state', self.states.append, qos.EVENTS)

    def wait(self, done: Callable[[Any], bool], seconds: float = 20.0) -> Any:
        """Wait for a state, from now on, of which something holds; return it."""
        self.states.clear()
        assert self.client.waiter.until(
            lambda: any(done(state) for state in self.states), seconds), self.states[-1:]
        return next(state for state in self.states if done(state))

    def idle(self, seconds: float) -> int:
        """Receive for a while; return how many states there were."""
        self.states.clear()
        self.client.waiter.until(lambda: False, seconds)
        return len(self.states)


def test_keys_fly_the_rocket_and_q_restores_the_terminal(
        processes: Processes, simulator: Process, terminal: PseudoTerminal,
        make_client: Callable[..., Client]) -> None:
    looker = Looker(make_client())
    child = terminal.fly(processes.env, level=1, seed=3, repeat_delay=2.0)
    # Nothing falls before the first flight; the state of the reset may arrive late.
    wait_until(lambda: looker.idle(0.3) == 0, 10.0)
    terminal.press(b'r')
    state = looker.wait(lambda s: s.time[-1] > 0.1)
    assert state.throttle[-1] == 0.0
    terminal.press(b'z')
    looker.wait(lambda s: s.throttle[-1] == 1.0)
    terminal.press(b'4')
    looker.wait(lambda s: s.throttle[-1] == pytest.approx(0.4))
    terminal.press(b'\x1b[')
    time.sleep(0.05)
    terminal.press(b'C')
    # To the right: the body's axis, z by REP 103, gets a part along x.
    looker.wait(lambda s: axis_x(s.orientation) > np.sin(np.deg2rad(4.0)))
    terminal.press(b'x')
    looker.wait(lambda s: s.throttle[-1] == 0.0)
    terminal.wait_for('full throttle')
    terminal.press(b'q')
    assert child.wait(20.0) == 0
    assert_restored(terminal)
    wait_until(lambda: looker.idle(0.5) == 0, 10.0)  # no agent flies, so nothing falls
    assert simulator.running


def axis_x(orientation: Any) -> float:
    """Return the x part of the body's z axis."""
    x, y, z, w = np.reshape(orientation, (-1, 4))[-1]
    return float(2 * (x * z + w * y))


def test_flight_ends_with_its_figures_and_the_experts(
        processes: Processes, terminal: PseudoTerminal) -> None:
    processes.run_node(
        'rocket_sim_node', 'simulator', num_envs=1, mode='realtime', realtime_factor=8.0)
    child = terminal.fly(processes.env)
    for number in (1, 2):
        terminal.press(b'r')
        terminal.wait_for(f'landed 0 of {number}')
        wait_until(
            lambda number=number: terminal.text.count('expert   29') >= number, 60.0,
            lambda: terminal.text)
    for text in ('CRASHED: too fast', 'the engine stayed off', 'start 1'):
        terminal.wait_for(text, 5.0)
    terminal.press(b'\x1b[113u')  # q, as terminals with the kitty protocol say it
    assert child.wait(20.0) == 0


def test_the_terminal_is_restored_however_the_pilot_ends(
        processes: Processes, simulator: Process, terminal: PseudoTerminal) -> None:
    for end in ('SIGTERM', 'SIGHUP', 'Ctrl-C', 'Ctrl-D'):
        child = terminal.fly(processes.env)
        assert not terminal.restored
        terminal.press(b'\x1a\x1c\x13')  # Ctrl-Z, Ctrl-\ and Ctrl-S mean nothing here
        if end == 'SIGTERM':
            terminal.press(b'r')
            terminal.wait_for(FLYING)
        if end == 'Ctrl-C':
            terminal.press(b'\x03')
        elif end == 'Ctrl-D':
            terminal.press(b'\x04')
        else:
            child.send_signal(signal.SIGHUP if end == 'SIGHUP' else signal.SIGTERM)
        assert child.wait(20.0) == 0, end
        assert_restored(terminal)


def test_the_terminal_is_restored_after_an_error(
        processes: Processes, terminal: PseudoTerminal) -> None:
    child = terminal.start(
        sys.executable, '-c',
        'import sys\n'
        'from ppo_agent_node.cockpit.raw_terminal import RawTerminal\n'
        'with RawTerminal() as terminal:\n'
        "    terminal.draw(['picture'])\n"
        "    sys.stderr.write('kept for later\\n'); sys.stderr.flush()\n"
        "    assert terminal.errors() == ['kept for later']\n"
        "    raise RuntimeError('on purpose')\n", env=processes.env)
    assert child.wait(20.0) == 1
    terminal.wait_for('on purpose')
    assert_restored(terminal)
    # It came when the first screen was back.
    assert terminal.output.index('kept for later') > terminal.output.index('\x1b[?1049l')


def test_ctrl_c_does_not_discard_a_key_that_is_about_to_be_read(
        processes: Processes, terminal: PseudoTerminal) -> None:
    """Otherwise the read would wait for the next key, and Ctrl-C would end nothing until then."""
    child = terminal.start(
        sys.executable, '-c',
        'import select, signal, time\n'
        'from ppo_agent_node.cockpit.raw_terminal import RawTerminal\n'
        'heard, look = [], select.select\n'
        'signal.signal(signal.SIGINT, lambda *_: heard.append(1))\n'
        'def slow(*given):\n'
        '    found = look(*given)\n'
        '    end = time.monotonic() + 10\n'
        '    while found[0] and not heard and time.monotonic() < end: time.sleep(0.01)\n'
        '    return found\n'
        'select.select = slow\n'
        'with RawTerminal() as terminal:\n'
        "    terminal.draw(['ready'])\n"
        '    key = terminal.read(10.0)\n'
        "print('read', key, 'heard', heard)\n", env=processes.env)
    terminal.wait_for('ready')
    terminal.press(b'r')
    time.sleep(0.2)
    terminal.press(b'\x03')
    assert child.wait(20.0) == 0
    terminal.wait_for("read b'r' heard [1]")


def test_the_pilot_without_a_terminal_is_refused(processes: Processes) -> None:
    pilot = processes.run_node('ppo_agent_node', 'keyboard_pilot')
    assert pilot.wait(20.0) == 2
    assert 'standard input: got no terminal' in pilot.output()
    assert 'Traceback' not in pilot.output()


def test_the_pilot_ends_without_a_simulator(
        processes: Processes, terminal: PseudoTerminal) -> None:
    child = terminal.start(
        'ros2', 'run', 'ppo_agent_node', 'keyboard_pilot', '--ros-args', '-p', 'patience:=0.5',
        env=processes.env)
    assert child.wait(20.0) == 2
    terminal.wait_for('is it running')
    assert 'Traceback' not in terminal.text
    assert_restored(terminal)


def test_the_engine_is_cut_after_a_kill_and_a_new_pilot_flies(
        processes: Processes, simulator: Process, terminal: PseudoTerminal,
        make_client: Callable[..., Client]) -> None:
    looker = Looker(make_client())
    child = terminal.fly(processes.env)
    terminal.press(b'r')
    looker.wait(lambda s: s.time[-1] > 0.0)
    terminal.press(b'z')
    looker.wait(lambda s: s.throttle[-1] == 1.0)
    os.killpg(child.pid, signal.SIGKILL)
    child.wait(5.0)
    looker.wait(lambda s: s.throttle[-1] == 0.0)
    simulator.wait_for('engine cut', 5.0)
    again = terminal.fly(processes.env)
    before = looker.states[-1].session
    terminal.press(b'r')
    looker.wait(lambda s: s.session != before and s.time[-1] > 0.0)
    terminal.press(b'z')
    looker.wait(lambda s: s.throttle[-1] == 1.0)
    terminal.press(b'q')
    assert again.wait(10.0) == 0


def test_a_killed_simulator_is_reported_and_a_new_one_flown(
        processes: Processes, simulator: Process, terminal: PseudoTerminal) -> None:
    child = terminal.fly(processes.env)
    terminal.press(b'r')
    terminal.wait_for(FLYING)
    simulator.signal(signal.SIGKILL)
    terminal.wait_for('is it running')
    processes.run_node('rocket_sim_node', 'simulator', num_envs=1, mode='realtime',
                       realtime_factor=8.0)
    for _ in range(10):
        # The pilot is waiting for the old one still, perhaps; then the key is for nothing.
        terminal.press(b'r')
        with suppress(AssertionError):
            terminal.wait_for('landed 0 of 1', 4.0)
            break
    assert 'landed 0 of 1' in terminal.text
    terminal.press(b'q')
    assert child.wait(20.0) == 0
    assert_restored(terminal)


def test_another_agent_in_control_is_reported(
        processes: Processes, simulator: Process, terminal: PseudoTerminal,
        make_client: Callable[..., Client]) -> None:
    other = make_client(agent=77)
    child = terminal.fly(processes.env)
    other.reset(1)  # only now: it is heard but this once, and its lease is 10 s
    terminal.press(b'r')
    terminal.wait_for('controls this simulator')
    other.close()
    terminal.press(b'q')
    assert child.wait(20.0) == 0
    assert 'Traceback' not in terminal.text


def test_lockstep_simulator_is_flown_at_the_pace_of_the_clock(
        processes: Processes, terminal: PseudoTerminal,
        make_client: Callable[..., Client]) -> None:
    processes.run_node('rocket_sim_node', 'simulator', num_envs=2, state_batch=1)
    looker = Looker(make_client())
    child = terminal.fly(processes.env)
    begin = time.monotonic()
    terminal.press(b'r')
    looker.wait(lambda s: s.time[-1] > 0.2)
    terminal.press(b'z')
    state = looker.wait(lambda s: s.time[-1] > 1.2)
    # Not faster than the clock, but for the first step, which comes at once.
    assert time.monotonic() - begin > state.time[-1] - 0.1
    assert list(state.throttle) == [1.0, 1.0]
    terminal.press(b'q')
    assert child.wait(20.0) == 0


def test_lander_is_flown(
        processes: Processes, terminal: PseudoTerminal,
        make_client: Callable[..., Client]) -> None:
    processes.run_node(
        'rocket_sim_node', 'simulator', num_envs=1, mode='realtime', world='lunar_lander',
        realtime_factor=0.5)
    looker = Looker(make_client())
    child = terminal.fly(processes.env)
    terminal.press(b'r')
    looker.wait(lambda s: s.time[-1] > 0.0)
    terminal.press(b'z')
    looker.wait(lambda s: s.throttle[-1] == 1.0)
    terminal.wait_for('height')
    assert 'fuel' not in terminal.text
    terminal.press(b'q')
    assert child.wait(20.0) == 0


def test_fly_runs_a_flight_and_records_it(
        processes: Processes, terminal: PseudoTerminal, tmp_path: Path) -> None:
    recording = tmp_path / 'flight.rrd'
    child = terminal.start(
        str(SCRIPTS / 'fly'), 'realtime_factor:=2.0', 'serve_web:=false', 'level:=2', 'seed:=7',
        f'output:={recording}', env=processes.env)
    terminal.wait_for('press r to fly', 60.0)
    terminal.press(b'r')
    terminal.wait_for('landed 0 of 1')
    assert 'level 2 · start 7' in terminal.text
    terminal.press(b'q')
    assert child.wait(20.0) == 0, terminal.text
    assert_restored(terminal)
    terminal.wait_for(f'recording: {recording}', 5.0)
    assert recording.is_file()


def test_fly_ends_all_processes_with_ctrl_c(
        processes: Processes, terminal: PseudoTerminal, tmp_path: Path) -> None:
    recording = tmp_path / 'flight.rrd'
    child = terminal.start(
        str(SCRIPTS / 'fly'), 'serve_web:=false', f'namespace:=/fly_{os.getpid()}',
        f'output:={recording}', env=processes.env)
    terminal.wait_for('press r to fly', 60.0)
    terminal.press(b'r')
    terminal.wait_for(FLYING)
    terminal.press(b'\x03')
    assert child.wait(20.0) == 0
    assert_restored(terminal)
    terminal.wait_for(f'recording: {recording}', 5.0)
    assert not running(f'/fly_{os.getpid()}')


def test_fly_ends_all_processes_when_its_terminal_is_closed(
        processes: Processes, terminal: PseudoTerminal, tmp_path: Path) -> None:
    recording, mine = tmp_path / 'flight.rrd', f'/fly_{os.getpid()}_closed'
    child = terminal.start(
        str(SCRIPTS / 'fly'), 'serve_web:=false', f'namespace:={mine}', f'output:={recording}',
        env=processes.env)
    terminal.wait_for('press r to fly', 60.0)
    terminal.press(b'r')
    terminal.wait_for(FLYING)
    terminal.hang_up()
    child.wait(40.0)
    wait_until(lambda: not running(mine), 10.0)
    assert recording.is_file(), 'complete, under its name'


@pytest.mark.parametrize('sent', [signal.SIGTERM, signal.SIGHUP], ids=lambda sent: sent.name)
def test_fly_signalled_during_its_start_leaves_no_process(
        processes: Processes, terminal: PseudoTerminal, sent: signal.Signals) -> None:
    mine = f'/fly_{os.getpid()}_early'
    child = terminal.start(
        str(SCRIPTS / 'fly'), 'serve_web:=false', f'namespace:={mine}', env=processes.env)
    # The launch has hardly begun, and does not hear of Ctrl-C yet.
    wait_until(lambda: bool(running(mine, 'fly.launch.yaml')), 60.0, lambda: terminal.text)
    os.kill(child.pid, sent)
    assert child.wait(40.0) == 143, terminal.text
    wait_until(lambda: not running(mine), 10.0)


def test_fly_restores_the_terminal_when_the_pilot_is_killed(
        processes: Processes, terminal: PseudoTerminal) -> None:
    child = terminal.start(
        str(SCRIPTS / 'fly'), 'serve_web:=false', f'namespace:=/fly_{os.getpid()}',
        env=processes.env)
    terminal.wait_for('press r to fly', 60.0)
    assert not terminal.restored
    for pid in running(f'/fly_{os.getpid()}', '/keyboard_pilot\0'):
        os.kill(pid, signal.SIGKILL)
    assert child.wait(20.0) > 2
    assert_restored(terminal)


def running(*words: str) -> list[int]:
    """Return the ids of the processes whose command line has all the words."""
    found = []
    for path in Path('/proc').glob('[0-9]*/cmdline'):
        with suppress(OSError):  # it has gone
            command = path.read_bytes()
            if all(word.encode() in command for word in words):
                found.append(int(path.parent.name))
    return found


def test_fly_without_a_terminal_is_refused_in_one_line(processes: Processes) -> None:
    fly = processes.start(str(SCRIPTS / 'fly'), 'level:=2')
    assert fly.wait(30.0) == 2
    assert 'standard input: got no terminal' in fly.output()
    assert len(fly.output().splitlines()) == 1
