# SPDX-License-Identifier: Apache-2.0
"""The actions of node `action_server`: feedback, results, cancellation, refusals."""
from __future__ import annotations

import math
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
import rclpy
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rocket_msgs.action import Evaluate
from rocket_msgs.action import Land
from rocket_msgs.action import Train
from support.processes import Process
from support.processes import Processes
from support.processes import wait_until

SMALL = [
    'curriculum_start_level:=3', 'curriculum_final_level:=3', 'demonstration_episodes:=16',
    'curriculum_wide_level:=4', 'dagger_rounds:=0', 'clone_epochs:=1', 'hidden_sizes:=[16,16]',
    'iterations:=12', 'n_steps:=16', 'batch_size:=64', 'selection_interval:=12',
    'selection_episodes:=8', 'evaluation_episodes:=8', 'critic_warmup_iterations:=1', 'threads:=1',
    'plots:=false', 'spawn_height:=40.0', 'time_limit:=6.0']
KINDS = {'train': Train, 'evaluate': Evaluate, 'land': Land}
EXAMPLE = Path(__file__).parents[3] / 'docs/examples/land_by_action.py'


class Operator:
    """A client of all actions."""

    def __init__(self, domain: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        node = Node('operator', context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(node)
        self._clients = {name: ActionClient(node, kind, name) for name, kind in KINDS.items()}

    def wait(self, done: Any, seconds: float = 60.0) -> None:
        """Spin until it is done."""
        def look() -> bool:
            self._executor.spin_once(timeout_sec=0.05)
            return bool(done())

        wait_until(look, seconds)

    def send(self, name: str, feedback: list[Any] | None = None, **fields: Any) -> Any:
        """Send a goal and return its handle, once it has been accepted."""
        client = self._clients[name]
        self.wait(client.server_is_ready)
        heard = [] if feedback is None else feedback
        answer = client.send_goal_async(
            KINDS[name].Goal(**fields), lambda message: heard.append(message.feedback))
        self.wait(answer.done)
        handle = answer.result()
        assert handle.accepted
        return handle

    def result(self, handle: Any, seconds: float = 90.0) -> tuple[int, Any]:
        """Return status and result of a goal, once it has one."""
        answer = handle.get_result_async()
        self.wait(answer.done, seconds)
        return answer.result().status, answer.result().result

    def cancel(self, handle: Any) -> None:
        """Cancel a goal."""
        answer = handle.cancel_goal_async()
        self.wait(answer.done)
        assert answer.result().goals_canceling


@pytest.fixture(scope='module')
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Processes]:
    """Return the processes of all tests here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        group = Processes(tmp_path_factory.mktemp('server'))
        yield group
        group.end()


@pytest.fixture(scope='module')
def server(shared: Processes, tmp_path_factory: pytest.TempPathFactory) -> Process:
    """Return the server, which makes its folder runs/ in one of the test."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp('project'))
        process = shared.run_node('ppo_agent_node', 'action_server')
    process.wait_for('are served', 30.0)
    return process


@pytest.fixture(scope='module')
def operator(shared: Processes, server: Process) -> Iterator[Operator]:
    """Return a client of the server."""
    made = Operator(shared.domain)
    yield made
    rclpy.shutdown(context=made.context)


def test_a_cancelled_training_can_be_resumed_to_its_end(
    operator: Operator, server: Process, tmp_path: Path,
) -> None:
    run, heard = tmp_path / 'run', []  # type: tuple[Path, list[Any]]
    goal = {'run_dir': str(run), 'record': False}
    first = operator.send('train', heard, num_envs=8, seed=3, arguments=SMALL, **goal)
    operator.wait(lambda: any(one.status.stage == 'finetune' for one in heard), 120.0)
    status, result = operator.result(operator.send('land', output=str(tmp_path / 'busy.rrd')))
    assert (status, result.code) == (GoalStatus.STATUS_ABORTED, Land.Result.BUSY)
    assert math.isnan(result.figures.landing_rate)
    assert result.message.startswith('train: a goal of it is being executed')
    operator.cancel(first)
    status, result = operator.result(first)
    assert (status, result.code) == (GoalStatus.STATUS_CANCELED, Train.Result.CANCELED), result
    assert result.message == f'cancelled; continue with the goal resume: true, run_dir: {run}'
    assert not (run / 'evaluation.json').exists()
    assert (run / 'checkpoints').is_dir()
    refused = operator.result(operator.send('train', **goal))[1]
    assert refused.message.startswith(f'run_dir: {run} already holds a run')

    heard.clear()
    status, result = operator.result(operator.send('train', heard, resume=True, **goal), 120.0)
    assert (status, result.code) == (GoalStatus.STATUS_SUCCEEDED, Train.Result.OK), result
    assert (result.message, result.run_dir) == ('', str(run))
    assert result.figures.episodes == 8
    assert 0.0 <= result.figures.landing_rate_low <= result.figures.landing_rate
    assert heard[-1].status.stage == 'done'
    assert any(one.text.split('] ')[1].startswith('PPO ') for one in heard), heard
    assert [one.status.iteration for one in heard if one.status.stage == 'finetune'][-1] == 12
    assert 'seed: 3' in (run / 'config.yaml').read_text()
    assert 'Traceback' not in server.output()


@pytest.mark.parametrize(('action', 'fields', 'complaint'), [
    ('train', {'world': 'moon'}, "world: got 'moon', expected one of rocket"),
    ('train', {'preset': 'fast'}, "preset: got 'fast', expected one of"),
    ('train', {'seed': -2}, 'seed: got'),
    ('train', {'resume': True}, 'resume:=true needs run_dir'),
    ('train', {'arguments': ['clip_rang:=0.2']},
     "unknown argument 'clip_rang', did you mean 'clip_range'?"),
    ('train', {'arguments': ['seed:=3']}, "arguments: got 'seed:=3', expected field seed"),
    ('evaluate', {'pilot': 'nobody'}, "pilot: got 'nobody', expected one of policy"),
    ('evaluate', {'conditions': 'all'}, "conditions: got 'all', expected one set"),
    ('land', {'policy': 'none'}, "policy: got 'none', expected a file or the name"),
    ('land', {'output': '/flights/landing.txt'},
     "output: got '/flights/landing.txt', expected a name")])
def test_an_invalid_goal_is_answered_in_one_line_that_names_the_field(
    operator: Operator, action: str, fields: dict[str, Any], complaint: str,
) -> None:
    status, result = operator.result(operator.send(action, **fields))
    assert (status, result.code) == (GoalStatus.STATUS_ABORTED, Train.Result.INVALID)
    assert math.isnan(result.figures.landing_rate)
    assert result.message.startswith(complaint)
    assert '\n' not in result.message


def test_evaluate_and_land_fly_a_policy_that_ships(
    operator: Operator, server: Process, shared: Processes, tmp_path: Path,
) -> None:
    heard: list[Any] = []
    before, begun = psutil.Process(server.pid).cpu_times(), time.monotonic()
    status, result = operator.result(operator.send(
        'evaluate', heard, policy='rocket', episodes=32, num_envs=32, optimum_sample=0))
    assert (status, result.code) == (GoalStatus.STATUS_SUCCEEDED, Evaluate.Result.OK), result
    assert (result.figures.episodes, result.figures.landed, result.output) == (32, 32, '')
    assert result.figures.mean_return > 290.0
    operator.wait(lambda: heard[-1].figures.episodes == 32)
    assert heard[-1].figures.landed == 32
    assert '/32 episodes: landed 100.0%' in heard[-1].text
    # The server leaves the cores to the processes of the goal.
    after, wall = psutil.Process(server.pid).cpu_times(), time.monotonic() - begun
    assert after.user + after.system - before.user - before.system < 0.2 * wall

    # The client of the documents.
    recording = tmp_path / 'landing.rrd'
    ended = subprocess.run(
        [sys.executable, str(EXAMPLE), str(recording)], env=shared.env, capture_output=True,
        text=True, timeout=90.0, check=True)
    assert recording.is_file()
    assert ' episodes: landed ' in ended.stdout
    assert ended.stdout.endswith(f'recording: {recording}\n')


def test_the_command_line_lists_actions_and_cancels_a_goal(
    operator: Operator, shared: Processes,
) -> None:
    listed = shared.start('ros2', 'action', 'list', '-t')
    assert listed.wait(60.0) == 0, listed.output()
    assert set(listed.output().splitlines()) >= {
        f'/{name} [rocket_msgs/action/{name.title()}]' for name in KINDS}

    refused = shared.start('ros2', 'action', 'send_goal', '/land', 'rocket_msgs/action/Land',
                           '{policy: none}')
    assert refused.wait(60.0) == 0, refused.output()
    assert "    message: 'policy: got ''none'', expected" in refused.output()
    assert 'Goal finished with status: ABORTED' in refused.output()

    goal = shared.start(
        'ros2', 'action', 'send_goal', '--feedback', '/land', 'rocket_msgs/action/Land',
        '{policy: rocket, episodes: 0}')
    goal.wait_for('Feedback:\n    figures:\n      episodes: ', 60.0)
    goal.signal(signal.SIGINT)
    goal.wait(60.0)
    assert 'Canceling goal...\nGoal canceled.' in goal.output()
    ending = goal.output().partition('Goal canceled.\n')[2]  # feedback may still follow
    ending = ending.rpartition('Result:\n')[2]
    assert ending.startswith('    code: 3\n    message: cancelled\n')
    assert ending.endswith('Goal finished with status: CANCELED\n')
    landed, = re.findall(r' landed: (\d+)\n', ending)
    assert int(landed) > 0
    # Without a name, the server gives the recording one.
    output, = re.findall(r' output: (.*)\n', ending)
    assert Path(output).is_file()
    assert Path(output).parent.name == 'runs'
    # The result comes after the recording; the next goal must find the server free.
    operator.wait(lambda: operator.result(operator.send('land', output='x'))[1].code != 2)


def test_a_stopped_server_finishes_its_goal_first(
    operator: Operator, shared: Processes, server: Process, tmp_path: Path,
) -> None:
    """Ends the server: the last test that uses it."""
    recording, heard = tmp_path / 'landing.rrd', []  # type: tuple[Path, list[Any]]
    handle = operator.send(
        'land', heard, output=str(recording), policy='rocket', episodes=0)
    operator.wait(lambda: heard)
    server.signal(signal.SIGINT)
    status, result = operator.result(handle)
    assert (status, result.code) == (GoalStatus.STATUS_ABORTED, Land.Result.FAILED), result
    assert result.message == 'the server was stopped'
    assert recording.is_file()
    assert result.output == str(recording)
    assert server.wait(20.0) == 0
    assert 'Traceback' not in server.output()


def test_no_process_outlives_a_killed_server(processes: Processes, tmp_path: Path) -> None:
    server = processes.run_node('ppo_agent_node', 'action_server')
    server.wait_for('are served', 30.0)
    operator, heard = Operator(processes.domain), []  # type: tuple[Operator, list[Any]]
    operator.send(
        'land', heard, policy='rocket', episodes=0, output=str(tmp_path / 'landing.rrd'))
    operator.wait(lambda: heard)
    started = psutil.Process(server.pid).children(recursive=True)
    assert len(started) >= 4  # the launch and its three nodes
    server.signal(signal.SIGKILL)
    assert psutil.wait_procs(started, timeout=40.0)[1] == []
    rclpy.shutdown(context=operator.context)
