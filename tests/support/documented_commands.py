# SPDX-License-Identifier: Apache-2.0
"""The commands and the Python code in README and docs, and how each is tested.

Each command belongs to the first of `KINDS` whose pattern it matches. The command is
run, with additional arguments that make it small; or another test runs it; or there is a reason
why it cannot be run.
"""
from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
GENERATED = ('commands.md', 'nodes-and-topics.md', 'parameters.md', 'python-api.md')
PAGES = [page for page in (
    ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', *sorted((ROOT / 'docs').rglob('*.md')))
    if page.name not in GENERATED]
_FENCED = re.compile(r'^```(\w*)[^\n]*\n(.*?)^```', re.MULTILINE | re.DOTALL)
_BEGINS = re.compile(
    r'\./launch_scripts/\w|\. launch_scripts/|PYTHON=|RANK=|python \S|torchrun --|fastdds d|'
    r'ros2 (run|launch|service call|action \w+|topic \w+|interface show) \S*[/_]')
"""Text in single backticks or in an indented block is a command if it begins like this."""


@dataclass(frozen=True)
class Kind:
    """A kind of command, and how it is tested."""

    pattern: str
    """pattern that matches the whole command"""
    append: str = ''
    """arguments that make it small; the last of several values for a `NAME` takes effect"""
    until: str = ''
    """output after which it is interrupted; empty: it ends by itself"""
    beside: tuple[str, ...] = ()
    """commands that run at the same time"""
    tested: str = ''
    """node id in pytest of the test that runs it"""
    reason: str = ''
    """why it cannot be run"""

    @property
    def is_run(self) -> bool:
        """Whether the command itself is run."""
        return not self.tested and not self.reason


TRAIN = (
    'num_envs:=8 demonstration_episodes:=8 dagger_rounds:=0 clone_epochs:=1 '
    'hidden_sizes:=[16,16] iterations:=1 n_steps:=32 batch_size:=256 selection_interval:=1 '
    'selection_episodes:=8 evaluation_episodes:=8 critic_warmup_iterations:=0 threads:=1 '
    'plots:=false record:=false')
FLY = 'num_envs:=8 episodes:=8'
EVALUATE = f'{FLY} optimum_sample:=0'
SIMULATOR = 'ros2 run rocket_sim_node simulator --ros-args -p num_envs:=8'
PILOT = 'ros2 run ppo_agent_node expert_pilot --ros-args -p episodes:=0'
_LEARN = ' '.join(
    f'-p {item}' for item in TRAIN.split() if not item.startswith(('num_envs', 'record')))
_BENCH = 'tests/system/commands/test_bench.py::test_'
_COMMANDS = 'tests/system/commands/test_commands.py::test_'
_KEYS = 'tests/system/user_interfaces/test_keyboard_pilot.py::test_'
_SCREEN = 'it needs a screen'
_HOURS = 'it takes hours'

KINDS = (
    # The environment, and tests
    Kind(r'\. launch_scripts/env\.sh'),
    Kind(r'\./launch_scripts/setup'),
    Kind(r'PYTHON=\S+ \./launch_scripts/setup',
         tested='tests/system/installation/test_setup.py::'
         'test_the_python_of_an_entered_shell_needs_no_new_set_up'),
    Kind(r'(HOVERSLAM_ROS=jazzy )?\./launch_scripts/test( --fast| --nightly)?',
         reason='it runs all tests, these included; .ci/run and contributors call it'),
    Kind(r'\./launch_scripts/test .*', '--collect-only -q'),
    Kind(r'python rocket_msgs/make_messages\.py',
         tested='tests/unit/rocket_sim_node/telemetry/test_tables.py::'
         'test_the_messages_are_current'),
    Kind(r'python docs/examples/sb3_ppo\.py .*',
         tested='tests/unit/test_examples.py::test_ppo_of_stable_baselines3_runs'),
    Kind(r'python docs/examples/single_file_ppo\.py .*',
         tested='tests/unit/test_examples.py::test_ppo_in_a_single_file_learns'),
    Kind(r'python docs/examples/sb3_sac\.py .*',
         tested='tests/unit/test_examples.py::test_sac_of_stable_baselines3_runs'),
    Kind(r'python docs/examples/rsl_rl_ppo\.py .*',
         tested='tests/unit/test_examples.py::test_ppo_of_rsl_rl_runs'),
    Kind(r'RANK=. ros2 run ppo_agent_node ppo_agent .*',
         tested='tests/system/training/test_training_ranks.py::'
         'test_two_agents_train_as_two_processes_without_ros_do'),
    Kind(r'fastdds discovery .*', reason='needs a full ROS 2; bench discovery runs its server'),
    Kind(r'torchrun .* docs/examples/train_ranks\.py .*',
         tested='tests/unit/test_examples.py::test_ranks_train_together'),
    Kind(r'python docs/examples/torchrl_ppo\.py .*',
         tested='tests/unit/test_examples.py::test_ppo_of_torchrl_runs'),
    Kind(r'(pip install|python -m build) .*',
         tested='tests/system/installation/test_wheels.py::'
         'test_worlds_adapters_training_evaluation_and_recording_work'),
    Kind(r'python docs/make_model_cards\.py --fly',
         tested='tests/unit/test_model_cards.py::test_a_card_is_current'),
    Kind(r'python docs/make_reference\.py',
         tested='tests/unit/test_documentation.py::test_a_generated_page_is_current'),
    Kind(r'export \w+=.*'),
    Kind(r'python', reason='it waits for input; the Python after it is run'),
    Kind(r'\./launch_scripts/(land|evaluate) .*\.onnx',
         tested='tests/node/agent/test_onnx_flight.py::test_nodes_fly_an_onnx_file_without_torch'),
    # Training
    Kind(r'\./launch_scripts/train loggers:=.*',
         tested='tests/unit/ppo_agent_node/runs/test_loggers.py::'
         'test_a_resumed_run_has_each_point_of_tensorboard_once'),
    Kind(r'\./launch_scripts/train --help .*'),
    Kind(r'\./launch_scripts/train (.*resume:=true|seed:=\d+( run_dir:=\S+)?|max_thrust:=.*)',
         tested=f'{_COMMANDS}a_run_in_an_awkward_folder_is_resumed_in_its_conditions'),
    Kind(r'\./launch_scripts/(train|land) world:=lunar_lander',
         tested=f'{_COMMANDS}train_evaluate_and_land_in_a_world_without_levels'),
    Kind(r'\./launch_scripts/train .*preset:=robust', f'{TRAIN} num_groups:=2'),
    Kind(r'\./launch_scripts/train .*serve_web:=true',
         f'{TRAIN} record:=true web_port:=$PORT'),
    Kind(r'\./launch_scripts/train .*connect:=.*', f'{TRAIN} record:=true'),
    Kind(r'\./launch_scripts/train .*from_scratch', reason='it learns for five minutes;'
         ' its arguments are checked'),
    Kind(r'\./launch_scripts/train( .*)?', TRAIN),
    # Flying and evaluating
    Kind(r'\./launch_scripts/land .*serve_web:=true.*', 'web_port:=$PORT', 'in a browser'),
    Kind(r'\./launch_scripts/land episodes:=8',
         tested=f'{_COMMANDS}land_flies_the_policy_that_ships'),
    Kind(r'\./launch_scripts/land( .*)?', FLY),
    Kind(r'\./launch_scripts/evaluate conditions:=all',
         'pilots:=expert level:=7 episodes:=1 num_envs:=1 optimum_sample:=0'),
    Kind(r'\./launch_scripts/evaluate conditions:=all pilots:=.*',
         reason='the same table takes minutes more; its arguments are checked'),
    Kind(r'\./launch_scripts/evaluate pilot:=expert',
         tested=f'{_COMMANDS}evaluate_the_expert'),
    Kind(r'\./launch_scripts/evaluate( .*)?', EVALUATE),
    Kind(r'\./launch_scripts/fly( .*)?', tested=f'{_KEYS}fly_runs_a_flight_and_records_it'),
    Kind(r'\./launch_scripts/compare .*', 'episodes:=2'),
    Kind(r'\./launch_scripts/(failures|report) .*'),
    Kind(r'\./launch_scripts/screenshot .*',
         tested='tests/unit/rocket_sim_node/recording/test_recording_settling.py::test_picture'),
    Kind(r'\./launch_scripts/pictures( only:=\w+ run_dir:=\S+)?',
         tested='tests/unit/ppo_agent_node/commands/test_pictures.py::'
         'test_the_command_makes_a_picture'),
    Kind(r'\./launch_scripts/secure .*',
         tested='tests/unit/launch_scripts/test_secure.py::'
         'test_a_command_starts_with_keys_that_are_made_once'),
    # Nodes
    Kind(r'ros2 run rocket_sim_node simulator.*', until='waiting for an agent'),
    Kind(r'ros2 run rocket_sim_node rerun_recorder .*serve_web:=true.*', '-p web_port:=$PORT',
         'in a browser'),
    Kind(r'ros2 run rocket_sim_node rerun_recorder .*', until='recording to'),
    Kind(r'ros2 run rocket_sim_node ros_bridge.*serve_foxglove.*', '-p foxglove_port:=$PORT',
         until='standard views of rockets'),
    Kind(r'ros2 run rocket_sim_node ros_bridge.*', until='standard views of rockets'),
    Kind(r'ros2 run rocket_sim_node bag_recorder .*', until='recording to'),
    Kind(r'ros2 run ppo_agent_node action_server', until='are served'),
    Kind(r'ros2 action .*', tested='tests/node/agent/test_action_server.py::'
         'test_the_command_line_lists_actions_and_cancels_a_goal'),
    Kind(r'python docs/examples/land_by_action\.py .*', tested='tests/node/agent/'
         'test_action_server.py::test_evaluate_and_land_fly_a_policy_that_ships'),
    Kind(r'ros2 bag .*', tested='tests/node/listeners/test_bag_recorder.py::'
         'test_a_bag_is_shown_and_played_by_the_command'),
    Kind(r'python -m rocket_sim_node\.bags\.to_rerun .*',
         tested='tests/unit/rocket_sim_node/bags/test_bags.py::test_a_recording_made_of_a_bag'),
    Kind(r'rviz2 .*', reason=_SCREEN),
    Kind(r'ros2 run ppo_agent_node (expert|random)_pilot .*__ns:=/sim_0.*', '-p episodes:=8',
         beside=(f'{SIMULATOR} -r __ns:=/sim_0',)),
    Kind(r'ros2 run ppo_agent_node (expert|random)_pilot .*', '-p episodes:=8',
         beside=(SIMULATOR,)),
    Kind(r'ros2 run ppo_agent_node ppo_agent .*', f'{_LEARN} -p run_dir:=runs/fleet',
         beside=(f'{SIMULATOR} -r __ns:=/sim_0', f'{SIMULATOR} -r __ns:=/sim_1')),
    Kind(r'ros2 run ppo_agent_node watch', until='clone',
         beside=(SIMULATOR, f'ros2 run ppo_agent_node ppo_agent --ros-args {_LEARN}')),
    Kind(r'ros2 run ppo_agent_node keyboard_pilot',
         tested=f'{_KEYS}keys_fly_the_rocket_and_q_restores_the_terminal'),
    Kind(r'python my_pilot\.py .*',
         tested=f'{_COMMANDS}the_pilot_of_the_tutorial_flies_and_lands'),
    Kind(r'ros2 topic list', until='/world', beside=(SIMULATOR,)),
    Kind(r'ros2 topic echo /training', until='stage: clone',
         beside=(SIMULATOR, f'ros2 run ppo_agent_node ppo_agent --ros-args {_LEARN}')),
    Kind(r'ros2 topic (echo .* --once)', beside=(SIMULATOR, PILOT)),
    Kind(r'ros2 topic hz /observation', until='average rate', beside=(SIMULATOR, PILOT)),
    Kind(r'ros2 interface show .*'),
    Kind(r'ros2 service call /simulator/reset .*', until='code=0', beside=(SIMULATOR,)),
    Kind(r'ros2 service call /simulator/get_simulator_features .*', until='custom_info=',
         beside=(SIMULATOR,)),
    Kind(r'ros2 service call /simulator/\w+ .*', until='result=1', beside=(SIMULATOR,)),
    Kind(r'ros2 launch (rocket_sim_node|ppo_agent_node) .*|(python -m )?colcon build',
         tested='tests/system/installation/test_foreign_workspace.py::'
         'test_the_launch_files_start_from_the_share_folder'),
    Kind(r'rosdep install .*|python3 -m venv .* && touch .*|\. venv/bin/activate|'
         r'python -m pip install .*', reason='it needs an installed ROS 2 and its package index'),
    Kind(r'python -m colcon test && python -m colcon test-result',
         tested='tests/system/installation/test_foreign_workspace.py::'
         'test_colcon_runs_the_tests_of_the_packages_and_counts_them'),
    # Benchmarks
    Kind(r'\./launch_scripts/bench PART --help'),
    Kind(r'\./launch_scripts/bench( PART)?', reason=_HOURS),
    Kind(r'\./launch_scripts/bench performance',
         tested='tests/unit/benchmarks/test_performance_page.py::'
         'test_the_newest_figures_are_taken_and_drawn'),
    *(Kind(rf'\./launch_scripts/bench {part}( .*)?', tested=f'{_BENCH}{part}') for part in (
        'budget', 'carriers', 'discovery', 'exchange', 'fleet', 'heuristic', 'hosts', 'learner',
        'loss', 'ranks', 'recorder', 'result', 'rollouts', 'stepping', 'stopping', 'threads')),
    Kind(r'\./launch_scripts/bench soak( .*)?',
         tested=f'{_BENCH}an_interrupted_soak_ends_its_nodes_and_writes_figures'),
    Kind(r'\./launch_scripts/bench (seeds|experiments|tune)( .*)?', reason=f'{_HOURS}; its '
         'arguments are checked'),
    Kind(r'\./launch_scripts/bench examples( .*)?', tested='tests/unit/benchmarks/'
         'test_examples_command.py::test_runs_are_trained_once_and_put_on_the_page'),
    Kind(r'\./launch_scripts/bench peers( .*)?', tested=f'{_BENCH}peers'),
    Kind(r'\./launch_scripts/bench transfer .*', '--policy $LANDER --episodes 4'),
    Kind(r'\./launch_scripts/bench key_latency', '--presses 3'),
    Kind(r'\./launch_scripts/bench gradients( .*)?', '--rollouts 3 --rockets 8 --log-std -2.5 '
         '--policy ppo_agent_node/ppo_agent_node/policies/robust.safetensors'),
    Kind(r'\./launch_scripts/bench optimum', '--starts 1 --fine 1 --blocks 60 --levels 1'),
    Kind(r'\./launch_scripts/bench onnx',
         '--rounds 1 --seconds 0.01 --sizes 1 --policies lunar_lander'),
    Kind(r'(\./launch_scripts/export .*|python -m ppo_agent_node\.commands\.export)',
         tested='tests/unit/ppo_agent_node/exporting/test_onnx.py::'
         'test_the_command_writes_a_file_once'),
    Kind(r'\./launch_scripts/bench conditions .*', '--rounds 1 --seconds 0.05 --sizes 4'),
    Kind(r'\./launch_scripts/bench digests', "--only 'rocket_planar conditions'"),
    # The viewer
    Kind(r'rerun mcap convert .*', tested='tests/unit/rocket_sim_node/bags/test_bags.py::'
         'test_rerun_shows_transforms_of_a_bag'),
    Kind(r'rerun .*', reason=_SCREEN),
)


@dataclass(frozen=True)
class Command:
    """A command as printed, and its page."""

    text: str
    page: str

    def __str__(self) -> str:
        """Return the command and its page."""
        return f'{self.text} ({self.page})'


def extended(text: str, words: str) -> str:
    """Return a command with more arguments, which replace those of the same names."""
    text = f'{text} {words}'
    if not text.startswith('./launch_scripts/'):
        return text
    return re.sub(r' (\w+):=\S*(?=.* \1:=)', '', text)


def _shell_lines(page: str) -> Iterator[str]:
    """Yield all commands on a page."""
    for language, code in _FENCED.findall(page):
        if language in ('sh', 'bash'):
            yield from code.splitlines()
    rest = _FENCED.sub('', page)
    found = [*re.findall(r'`([^`]+)`', rest), *re.findall(r'^    (\S.*)', rest, re.MULTILINE)]
    yield from (each for each in found if _BEGINS.match(each))


def commands() -> list[Command]:
    """Return the commands of all pages, without duplicates."""
    found: dict[str, Command] = {}
    for page in PAGES:
        for line in _shell_lines(page.read_text('utf-8')):
            text = ' '.join(re.sub(r'\s+#.*', '', line).split())
            if text:
                found.setdefault(text, Command(text, str(page.relative_to(ROOT))))
    return list(found.values())


def python_blocks() -> Iterator[tuple[str, str]]:
    """Yield page and code of each block of Python."""
    for page in PAGES:
        for language, code in _FENCED.findall(page.read_text('utf-8')):
            if language == 'python':
                yield str(page.relative_to(ROOT)), code


def kind_of(command: Command) -> Kind:
    """Return the kind of a command.

    :raises LookupError: if no kind matches.
    """
    for kind in KINDS:
        if re.fullmatch(kind.pattern, command.text):
            return kind
    raise LookupError(
        f'{command}: a new command; add how it is tried to tests/support/documented_commands.py')
