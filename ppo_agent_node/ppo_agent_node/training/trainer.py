# SPDX-License-Identifier: Apache-2.0
"""Training run: demonstrations, cloning, and fine-tuning by PPO.

Equal seeds, and equal numbers of ranks, give equal weights, bit for bit, regardless of the fleet
and its number of simulators, of simulator restarts, and of whether the run was stopped and
resumed.
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence
from dataclasses import asdict
from dataclasses import replace
from pathlib import Path
from typing import Any

from ppo_agent_node.config.training_config import Config
from ppo_agent_node.config.training_config import check_world
from ppo_agent_node.config.training_config import fit_copies
from ppo_agent_node.distributed.ranks import ALONE
from ppo_agent_node.distributed.ranks import Ranks
from ppo_agent_node.flying.episodes import Pilot
from ppo_agent_node.imitation.dagger import Imitation
from ppo_agent_node.pilots.teacher import scripted_teacher
from ppo_agent_node.ppo.episode_rollout import EpisodeRollout
from ppo_agent_node.ppo.learner import Learner
from ppo_agent_node.ppo.rollout_buffer import Rollout
from ppo_agent_node.ppo.rollout_buffer import in_order
from ppo_agent_node.runs import episode_scores
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.runs.loggers import MakeLogger
from ppo_agent_node.runs.metrics_logger import MetricsLogger
from ppo_agent_node.runs.metrics_logger import Progress
from ppo_agent_node.runs.tensor_file import TensorFile
from ppo_agent_node.runs.tensor_file import Tensors
from ppo_agent_node.threads import tensor_threads
from ppo_agent_node.training import preflight
from ppo_agent_node.training import run_state
from ppo_agent_node.training.checkpointing import CheckpointWriter
from ppo_agent_node.training.curriculum import Curriculum
from ppo_agent_node.training.group_worlds import GroupWorlds
from ppo_agent_node.training.interruptible_fleet import InterruptibleFleet
from ppo_agent_node.training.reverse_curriculum import ReverseCurriculum
from ppo_agent_node.training.run_state import RunState
from ppo_agent_node.training.selection import Score
from ppo_agent_node.training.selection import Selector
from ppo_agent_node.training.stop_criterion import Result
from ppo_agent_node.training.stop_criterion import StopCriterion
from rocket_sim_node.telemetry.training_status import Status
from rocket_sim_node.worlds import EnvironmentClosed
from rocket_sim_node.worlds.jobs import Fleet


class Trainer:
    """Trains one policy in one world, in a folder from which the run can be resumed."""

    def __init__(
        self,
        fleet: Fleet,
        config: Config,
        folder: RunFolder,
        report: Callable[[Status], None] = lambda status: None,
        expert: Pilot | None = None,
        stop_requested: Callable[[], bool] = lambda: False,
        say: Callable[[str], None] = lambda line: None,
        loggers: Sequence[MakeLogger] = (),
        ranks: Ranks = ALONE,
    ) -> None:
        """Prepare a run; nothing flies yet.

        :param report: called with a status for each iteration and each event.
        :param expert: the pilot to imitate; by default the scripted one with the gains of the
            settings.
        :param stop_requested: called before each step and each minibatch.
        :param say: called with a line for each episode, if the settings ask for it.
        :param loggers: receive the lines of the log; see `runs.loggers`.
        :param ranks: the processes that train this run together, each with a fleet of its own;
            see `distributed`. Each flies its part of the groups.
        :raises ValueError: when demonstrations are needed and the scripted pilot cannot fly the
            world, or when a setting does not fit the world.
        """
        spec = self._spec = fleet.spec
        config = fit_copies(config, spec.num_envs)
        self._config, self._folder, self._say, self._ranks = config, folder, say, ranks
        check_world(config, spec)
        if config.ppo.num_groups % ranks.count:
            raise ValueError(
                f'num_groups: got {config.ppo.num_groups}, expected a multiple of the number of '
                f'ranks, {ranks.count}')
        if config.demonstration.demonstration_episodes and expert is None:
            levels = config.curriculum
            expert = scripted_teacher(
                spec.after_reset(levels.task_settings(0)), config.demonstration,
                spec.after_reset(levels.wide_settings) if levels.curriculum_wide_level else None)
        self._expert = expert if config.demonstration.demonstration_episodes else None
        self._stop_criterion = StopCriterion(
            config.ppo.iterations, config.run.training_episodes, config.run.target_return)
        self._score_lines = episode_scores.ScoreLines(config.run.training_episodes)
        self._learner = Learner(spec, config, ranks)
        self._fleet = InterruptibleFleet(
            fleet, ranks, stop_requested, lambda text: self._metrics.message(text))
        self._metrics = MetricsLogger(
            folder, report, lambda: self._fleet.messages_dropped, loggers)
        imitation = ('demonstrate', 'clone') if config.demonstration.demonstration_episodes else ()
        self._metrics.keep(stages=(*imitation, 'finetune'))
        self._state = RunState(
            Curriculum.begin(config.curriculum),
            ReverseCurriculum.begin(config.curriculum, spec))
        groups = config.ppo.num_groups // ranks.count
        self._rollout = EpisodeRollout(
            spec.num_envs, config.ppo.start_copies, groups, config.ppo.normalise_starts,
        ) if config.ppo.whole_episodes else Rollout(
            config.ppo.n_steps, spec.num_envs, spec.observation_size, self._learner.policy,
            groups)
        self._worlds = GroupWorlds(spec, config, self._fleet.fly, ranks.count)
        self._selector = Selector(spec, config, self._metrics, self._fleet.fly)
        self._checkpoints = CheckpointWriter(
            spec, config, folder, self._metrics, ranks.count)

    def run(self) -> Result:
        """Train until done or asked to stop; resumes the folder's run, if it has one.

        :raises ValueError: when the folder's run had other settings or its files are damaged.
        :raises OSError: when the folder cannot be written; the last checkpoint is complete.
        :raises RankLost: when another rank is gone or has failed; if fine-tuning had begun, rank 0
            has saved it.
        """
        finished = False
        self._check_ranks()
        saved = self._folder.newest(self._metrics.message)
        try:
            if saved is None:
                preflight.try_starts(self._fleet.fly, self._config)
                self._metrics.take_up(0, 0)
                self._folder.write_config(run_state.description(self._spec, self._config))
                self._imitate()
                self._begin_finetuning()
            else:
                self._take_up(*saved)
            self._finetune()
            self._ranks.main.gather(None, self._fleet.poll)  # once rank 0 has saved everything
            finished = True
        except EnvironmentClosed:
            begun = any(self._folder.checkpoints.iterdir())
            self._metrics.message(
                'stopped; a resumed run continues from here' if begun else
                'stopped before the first checkpoint; a resumed run starts from the beginning')
        finally:
            self._metrics.close()
        return Result(finished, self._state.iteration, self._state.best, self._folder.policy)

    def _check_ranks(self) -> None:
        """Check that all ranks train the same run.

        :raises ValueError: names a setting that differs.
        """
        run_state.check_alike(self._ranks.main.gather(
            run_state.description(self._spec, self._config), self._fleet.poll))

    def _take_up(self, path: Path, checkpoint: TensorFile) -> None:
        tensors = dict(checkpoint.tensors)
        self._state = run_state.from_content(path, checkpoint, self._spec, self._config)
        self._worlds.take(path, tensors)
        self._learner.load(path, tensors)
        self._folder.go_on_from(path)
        self._metrics.take_up(self._state.lines, self._state.steps)
        if self._config.run.episode_lines:
            for line in self._folder.lines():
                self._score_lines.add(line.get('scores') or ())
        # Fails now if the simulators refuse them, before there is work to lose.
        preflight.try_snapshots(self._fleet.fly, path, self._worlds.snapshots)
        # Some settings may have changed, such as the number of evaluated episodes.
        self._folder.write_config(run_state.description(self._spec, self._config))
        self._selector.tell(self._state.best)
        self._metrics.keep(saved=f'{path.parent.name}/{path.name}')
        self._begin_stage_finetune()
        change = run_state.change_of_ranks(checkpoint, self._ranks.count)
        self._metrics.message(f'resumed from {path.name}{change}')

    def _imitate(self) -> None:
        """Clone the expert into the policy."""
        if self._expert is None:
            return
        imitation = Imitation(
            self._spec, self._config, self._expert, self._fleet.fly, self._metrics,
            self._fleet.poll_learning)
        imitation.teach(self._learner.policy)
        self._learner.copy_first(self._fleet.poll)
        self._state = replace(self._state, steps=self._state.steps + imitation.steps)
        self._learner.critic.normaliser.copy_from(self._learner.policy.normaliser)
        self._checkpoints.save_clone(self._learner.policy, self._state)

    def _begin_finetuning(self) -> None:
        """Evaluate the clone, reset the worlds to the first level and save: iteration 0.

        Without a clone, the untrained policy is not evaluated.
        """
        self._begin_stage_finetune()
        self._reset_world()
        best, numbers = self._select(self._expert is not None)
        numbers |= self._state.reverse.figures()
        self._finish_iteration(best, level=self._state.curriculum.level, **numbers)

    def _begin_stage_finetune(self) -> None:
        self._metrics.begin(
            'finetune', self._config.ppo.iterations, self._state.iteration, self._progress())

    def _finetune(self) -> None:
        self._begin_stage_finetune()
        while not self._done():
            state, tensors = self._state, self._tensors()
            try:
                self._iterate()
            except (RuntimeError, TimeoutError, ValueError):
                # Stopped, or no simulator is left: save what was learned.
                self._state = state
                self._checkpoints.save(tensors, self._learner.policy, state)
                raise

    def _done(self) -> bool:
        state = self._state
        return self._stop_criterion.reached(state.iteration, state.episodes, state.best_return)

    def _progress(self) -> Progress:
        return self._stop_criterion.progress(self._state.iteration, self._state.episodes)

    def _iterate(self) -> None:
        """Run one iteration: roll-out, update, evaluation and checkpoint."""
        iteration, state = self._state.iteration + 1, self._state
        rollout, policy = self._rollout, self._learner.policy
        flown = self._worlds.roll_out(rollout, policy, state)
        episodes = in_order(flown)
        with tensor_threads(self._config.run.threads):
            diagnostics, learning_rate = self._learner.learn(
                iteration, rollout, self._fleet.poll_learning)
        outcomes = self._spec.outcomes
        self._state = replace(
            state.advance(
                episode_scores.landed(self._worlds.judged(flown), outcomes),
                episode_scores.landed(self._worlds.hardest(flown, state), outcomes)),
            iteration=iteration,
            steps=state.steps + sum(self._ranks.main.gather(rollout.steps, self._fleet.poll)),
            episodes=state.episodes + len(episodes))
        if message := self._state.news(state):
            self._reset_world()
        best, numbers = self._select(
            self._selector.due(iteration, self._state.landing_rate, harder=bool(message)))
        if self._config.run.episode_lines:
            numbers['scores'] = episodes.episode_return.tolist()
            for line in self._score_lines.add(numbers['scores']):
                self._say(line)
        self._finish_iteration(
            best, message, level=state.curriculum.level, learning_rate=learning_rate,
            **state.reverse.figures(),
            **episode_scores.figures(episodes, outcomes, self._config.ppo.start_copies),
            **asdict(diagnostics), **policy.diagnostics(), **numbers)

    def _reset_world(self) -> None:
        """Start new episodes in the worlds of all groups."""
        self._state = replace(self._state, reset_iteration=self._state.iteration)
        steps = self._worlds.reset(self._learner.policy, self._state)
        self._state = replace(self._state, steps=self._state.steps + steps)

    def _select(self, due: bool) -> tuple[Score | None, dict[str, Any]]:
        """Evaluate the policy without noise if that is due, or if this is the last iteration.

        :return: its score if it is the best so far, and values for the log.
        """
        if not (due or self._done()):
            return None, {}
        state = self._state
        selected = self._selector.select(self._learner.policy, state.iteration, state.best)
        best = selected.score if selected.better else None
        self._state = replace(
            state, steps=state.steps + selected.steps, best=best or state.best)
        return best, selected.numbers

    def _finish_iteration(self, best: Score | None, message: str = '', **numbers: Any) -> None:
        """Write the log line, and the files that are due."""
        state, interval = self._state, self._config.run.checkpoint_interval
        due = best or self._done() or state.iteration % interval == 0
        if best:
            note = f'best policy so far: return {best.mean_return:.1f}'
            message = f'{message}, {note}' if message else note
        self._metrics.entry(
            state.iteration, state.steps, message,
            0.0 if self._done() else self._stop_criterion.left(state.iteration, state.episodes),
            self._progress(), **numbers)
        self._state = replace(state, lines=self._metrics.lines)
        if due:
            self._checkpoints.save(self._tensors(), self._learner.policy, self._state, best)

    def _tensors(self) -> Tensors:
        return {**self._learner.tensors(), **self._worlds.tensors()}
