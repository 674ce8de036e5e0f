# SPDX-License-Identifier: Apache-2.0
"""Mode `train`: a training run with settings from parameters and reports on `training`."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.executors import Executor
from rclpy.node import Node

from ppo_agent_node.config import presets
from ppo_agent_node.config import training_config
from ppo_agent_node.config.connection_config import simulators_setting
from ppo_agent_node.config.training_config import Config
from ppo_agent_node.config.training_config import fit_copies
from ppo_agent_node.distributed.errors import RankLost
from ppo_agent_node.distributed.ranks import Ranks
from ppo_agent_node.distributed.rendezvous import joined
from ppo_agent_node.distributed.run_folder import open_folder
from ppo_agent_node.evaluation import metrics
from ppo_agent_node.imitation.cloning import CloningFailed
from ppo_agent_node.nodes.agent.status_publisher import StatusPublisher
from ppo_agent_node.nodes.flights.connection import ConnectionParameters
from ppo_agent_node.nodes.flights.connection import agent_of_run
from ppo_agent_node.nodes.flights.connection import make_fleet
from ppo_agent_node.nodes.flights.connection import require_lockstep
from ppo_agent_node.nodes.flights.evaluation import fly_and_write
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.runs.loggers import MakeLogger
from ppo_agent_node.runs.loggers import find as find_loggers
from ppo_agent_node.terminal import Terminal
from ppo_agent_node.training.trainer import Trainer
from rocket_sim_node import settings
from rocket_sim_node.settings import setting
from rocket_sim_node.telemetry.training_status import Status
from rocket_sim_node.wire.client.connection import SimulatorBusy
from rocket_sim_node.wire.client.fleet import SimulatorFleet
from rocket_sim_node.wire.client.membership import check_pattern
from rocket_sim_node.wire.client.membership import check_second
from rocket_sim_node.wire.node import stopping
from rocket_sim_node.wire.node.parameters import ParameterError
from rocket_sim_node.wire.node.parameters import Parameters
from rocket_sim_node.wire.node.waiting import WireTimeout
from rocket_sim_node.worlds import EnvironmentClosed
from rocket_sim_node.worlds import EnvironmentRestarted


@dataclass(frozen=True)
class TrainingParameters:
    """Parameters of mode `train`, beside the settings of the run."""

    run_dir: str = setting('', '', 'folder of the run; empty: runs/run-001 or the next free '
        'number')
    resume: bool = setting(
        False, '', 'whether to resume the run in run_dir; if it holds none, a new one begins')
    simulators: str = simulators_setting()
    second_simulator: str = setting(
        '', '', "namespace, below the agent's own, of a second simulator, which flies at the same "
        'time; only without simulators')
    preset: str = setting(
        'default', '', "preset on which the run's settings are based",
        choices=presets.preset_names())
    loggers: str = setting(
        '', '', 'additional loggers, separated by commas: tensorboard, package.module:Class '
        'or file.py:Class')


def train(node: Node, executor: Executor, parameters: Parameters) -> int:
    """Train with the simulators of this namespace, evaluate, plot; return the exit status.

    With the environment variables of torchrun it is a rank of a run of several agents.
    """
    options = parameters.declare(TrainingParameters)
    connection = parameters.declare(ConnectionParameters)
    _check_given(node, parameters)
    check_pattern(options.simulators)
    check_second(options.second_simulator, options.simulators)
    path = _run_path(options)
    try:
        with joined(poll=_check_stop, say=node.get_logger().info) as ranks:
            loggers = find_loggers(options.loggers) if ranks.first else ()
            with (
                open_folder(path, options.resume, ranks, _check_stop) as folder,
                Terminal() if ranks.first else nullcontext() as terminal,
                make_fleet(
                    node, executor, connection,
                    options.simulators.replace('{rank}', str(ranks.index)),
                    agent_of_run(path if ranks.first else path / f'rank_{ranks.index}'),
                    options.second_simulator) as fleet,
            ):
                if terminal is None:
                    return _follow(node, parameters, options, fleet, folder, ranks)
                return _lead(
                    node, parameters, options, fleet, folder, terminal, loggers, ranks)
    except EnvironmentClosed:  # while waiting for the other ranks
        node.get_logger().info('stopped before the training began')
        return 0


def _check_stop() -> None:
    """Raise EnvironmentClosed when this process is asked to stop."""
    if stopping.requested():
        raise EnvironmentClosed('asked to stop')


def _follow(
    node: Node, parameters: Parameters, options: TrainingParameters, fleet: SimulatorFleet,
    folder: RunFolder, ranks: Ranks,
) -> int:
    """Train as a rank other than the first, which writes the files and publishes the status."""
    def stop_requested() -> bool:
        fleet.keep()
        return stopping.requested()

    def report(status: Status) -> None:
        if status.message and not status.message.startswith('saved '):  # in a temporary folder
            node.get_logger().info(status.message)

    saved = _saved_settings(folder) if options.resume else {}
    config = _config(parameters, options.preset, fleet.connect().name, saved)
    require_lockstep(fleet)
    Trainer(fleet, config, folder, report, stop_requested=stop_requested, ranks=ranks).run()
    return 0


def _lead(
    node: Node, parameters: Parameters, options: TrainingParameters, fleet: SimulatorFleet,
    folder: RunFolder, terminal: Terminal, loggers: Sequence[MakeLogger], ranks: Ranks,
) -> int:
    """Train as the first rank, or the only one."""
    saved = _saved_settings(folder) if options.resume else {}

    def tick() -> None:
        fleet.keep()
        terminal.tick()

    def stop_requested() -> bool:
        tick()
        return stopping.requested()

    if not folder.finished:  # a finished run stays finished if it cannot be opened
        folder.mark_unfinished()
    publisher = StatusPublisher(node, terminal, folder, options.second_simulator)
    if options.resume and not folder.begun:
        terminal.say(f'{folder.path} holds no run to resume: a new one begins')
    try:
        config = _config(parameters, options.preset, fleet.connect().name, saved)
        require_lockstep(fleet)
        spec = fleet.spec
        usual = presets.preset_num_envs(options.preset, spec.name)
        if not saved and spec.num_envs != usual:
            terminal.say(
                f'num_envs is {spec.num_envs}; preset {options.preset} of {spec.name} was made '
                f'with {usual}')
        asked = config.ppo.start_copies
        if (copies := fit_copies(config, spec.num_envs).ppo.start_copies) != asked:
            terminal.say(
                f'start_copies is {copies}, not {asked}, which does not divide num_envs'
                + ('; PPO uses a critic instead' if copies == 1 else ''))
        result = Trainer(
            fleet, config, folder, publisher.report, stop_requested=stop_requested,
            say=terminal.say, loggers=loggers, ranks=ranks).run()
        if result.finished:
            folder.mark_unfinished()
            try:
                _evaluate(fleet, config, folder, publisher, terminal, tick)
            except EnvironmentClosed:
                publisher.report_evaluation(Status(
                    stage='evaluate', message='stopped; a resumed run repeats the evaluation'))
                raise
            folder.mark_finished()
            return 0
    except EnvironmentClosed:
        pass
    except (WireTimeout, SimulatorBusy, EnvironmentRestarted, RankLost):
        publisher.advise(options.simulators, options.loggers)
        raise
    except CloningFailed:
        folder.mark_finished()  # a resumed run would have the same result
        raise
    except (ValueError, OSError):
        folder.withdraw()
        raise
    publisher.advise(options.simulators, options.loggers)
    return 0


def _run_path(options: TrainingParameters) -> Path:
    if options.run_dir:
        return Path(options.run_dir)
    if options.resume:
        raise ParameterError('parameter run_dir: empty, expected the folder of the run to resume')
    number = 1
    while (path := Path('runs') / f'run-{number:03d}').exists():
        number += 1
    return path


def _check_given(node: Node, parameters: Parameters) -> None:
    """Check the parameters of the run as far as possible without its world.

    Which preset provides the other values is known only after the simulator has described its
    world, but a misspelt name should be reported without waiting for one.

    :raises ParameterError: for an unknown name, a value of the wrong type or out of range.
    """
    infos = {info.name: info for info in training_config.describe()}
    known = [*node.get_parameters_by_prefix(''), *infos]
    unknown = sorted(set(parameters.given) - set(known))
    if unknown:
        raise ParameterError(
            f'unknown parameter {", ".join(map(repr, unknown))}, expected {", ".join(known)}')
    for name in parameters.given.keys() & infos.keys():
        try:
            settings.check(infos[name], parameters.given[name])
        except (ValueError, TypeError) as error:
            raise ParameterError(f'parameter {error}') from error


def _saved_settings(folder: RunFolder) -> dict[str, Any]:
    """Return the settings of the resumed run, by name."""
    saved = folder.read_config().get('training', {})
    if not isinstance(saved, dict):
        raise ValueError(f'{folder.config}: training is {saved!r}, expected names and values')
    return saved


def _config(
    parameters: Parameters, preset: str, world: str, saved: dict[str, Any],
) -> Config:
    """Return the settings: given ones, else those of the resumed run, else the preset's.

    When a run is resumed with a preset other than `default`, it must be the one that the run began
    with; `default` means nothing, since launch files always pass it.
    """
    values = saved
    if not saved or preset != TrainingParameters.preset:
        values = {**saved, **presets.preset_values(preset, world)}
    return training_config.make_config(
        parameters.declare_infos(training_config.describe(), values))


def _evaluate(
    fleet: SimulatorFleet, config: Config, folder: RunFolder, publisher: StatusPublisher,
    terminal: Terminal,
    tick: Callable[[], None],
) -> None:
    """Fly the best policy on new starts; write the figures, and the plots if wanted."""
    level = config.curriculum.curriculum_final_level
    summary = fly_and_write(
        fleet, PolicyPilot(folder.policy, fleet.spec), config.run.evaluation_episodes,
        config.run.evaluation_seed, level, folder.path, publisher.report_evaluation, folder.name,
        tick, settings=config.curriculum.task_settings(level), plots=config.run.plots,
        sections=('Evaluation', 'Training'), training_seed=config.run.seed)
    terminal.say(metrics.table(summary))
    low, high = summary['landing_rate_interval']
    publisher.report_evaluation(Status(
        stage='done', level=level, landing_rate=summary['landing_rate'], landing_rate_low=low,
        landing_rate_high=high, mean_return=summary['mean_return'], saved='evaluation.json',
        message=f'all files are in {folder.path}'))
