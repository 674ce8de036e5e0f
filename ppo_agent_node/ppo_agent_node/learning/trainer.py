# SPDX-License-Identifier: Apache-2.0
"""A training run from nothing to a policy: demonstrate, clone, fine-tune by PPO.

Equal seeds give equal weights, bit for bit, whichever fleet it flies in, of however many
simulators, however often they restart, and whether or not the run was stopped and resumed.
"""
from __future__ import annotations

import functools
import math
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from dataclasses import asdict
from dataclasses import dataclass
from dataclasses import replace
from pathlib import Path
from typing import Any
from typing import TypeVar

import numpy as np

from ppo_agent_node.evaluation.intervals import wilson
from ppo_agent_node.learning import rehearsal
from ppo_agent_node.learning import run_state
from ppo_agent_node.learning import scores
from ppo_agent_node.learning import streams
from ppo_agent_node.learning.config import Config
from ppo_agent_node.learning.config import check_world
from ppo_agent_node.learning.curriculum import Curriculum
from ppo_agent_node.learning.demonstrations import scripted_teacher
from ppo_agent_node.learning.ending import Ending
from ppo_agent_node.learning.episode_rollout import EpisodeRollout
from ppo_agent_node.learning.flights import Pilot
from ppo_agent_node.learning.flights import scatter
from ppo_agent_node.learning.imitation import Imitation
from ppo_agent_node.learning.journal import Journal
from ppo_agent_node.learning.journal import Progress
from ppo_agent_node.learning.learner import Learner
from ppo_agent_node.learning.policies import without_noise
from ppo_agent_node.learning.policy_file import save_policy
from ppo_agent_node.learning.reverse_curriculum import ReverseCurriculum
from ppo_agent_node.learning.rollout import Ended
from ppo_agent_node.learning.rollout import Rollout
from ppo_agent_node.learning.rollout import in_order
from ppo_agent_node.learning.run_folder import RunFolder
from ppo_agent_node.learning.run_state import RunState
from ppo_agent_node.learning.sealed_file import Sealed
from ppo_agent_node.learning.sealed_file import Tensors
from ppo_agent_node.learning.selection import Score
from ppo_agent_node.learning.selection import fly_selection
from ppo_agent_node.learning.status import Status
from ppo_agent_node.learning.threads import tensor_threads
from rocket_sim_node import free_memory
from rocket_sim_node.worlds import EnvironmentClosed
from rocket_sim_node.worlds import Episodes
from rocket_sim_node.worlds.flight import Fleet
from rocket_sim_node.worlds.flight import Flight
from rocket_sim_node.worlds.flight import Reset
from rocket_sim_node.worlds.flight import Restore
from rocket_sim_node.worlds.flight import Snapshot

T = TypeVar('T')


@dataclass(frozen=True)
class Result:
    """How a run ended."""

    finished: bool
    """False when it was stopped; it can be resumed"""
    iterations: int
    """done, of fine-tuning"""
    best: Score | None
    """of the policy in `policy`; None when none has been flown yet"""
    policy: Path


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
    ) -> None:
        """Prepare a run; nothing flies yet.

        :param report: is told of each iteration, and of what else happens.
        :param expert: the pilot to imitate; by default the scripted one with the gains of the
            settings.
        :param stop_requested: asked before each step and each minibatch.
        :param say: is told the lines of episodes, where the settings ask for them.
        :raises ValueError: when there are to be demonstrations and the scripted pilot cannot fly
            the world, or when a setting is not for it.
        """
        self._fleet, self._config, self._folder = fleet, config, folder
        spec = self._spec = fleet.spec
        check_world(config, spec)
        if config.demonstration.demonstration_episodes and expert is None:
            expert = scripted_teacher(
                spec.after_reset(config.curriculum.task_settings(0)), config.demonstration)
        self._expert = expert if config.demonstration.demonstration_episodes else None
        self._stop_requested, self._say = stop_requested, say
        self._ending = Ending(
            config.ppo.iterations, config.run.training_episodes, config.run.target_return)
        self._score_lines = scores.ScoreLines(config.run.training_episodes)
        self._learner = Learner(spec, config)
        self._journal = Journal(folder, report)
        imitation = ('demonstrate', 'clone') if config.demonstration.demonstration_episodes else ()
        self._journal.keep(stages=(*imitation, 'finetune'))
        self._state = RunState(
            Curriculum.begin(config.curriculum),
            ReverseCurriculum.begin(config.curriculum, spec))
        groups = config.ppo.num_groups
        self._rollout = EpisodeRollout(
            spec.num_envs, config.ppo.start_copies, groups) if self._whole_episodes else Rollout(
            config.ppo.n_steps, spec.num_envs, spec.observation_size, self._learner.policy, groups)
        self._give_back = free_memory.NowAndThen()
        self._worlds = [b''] * groups
        """snapshots of the world of each group: the last moment of it that is certain"""

    def run(self) -> Result:
        """Train until done or asked to stop; from where the folder's run ended, if it has one.

        :raises ValueError: when the folder's run had other settings or its files are damaged.
        :raises OSError: when the folder cannot be written; the last checkpoint is whole.
        """
        finished = False
        saved = self._folder.newest(self._journal.message)
        try:
            if saved is None:
                rehearsal.try_starts(self._fly, self._config)
                self._journal.take_up(0, 0)
                self._folder.write_config(run_state.description(self._spec, self._config))
                self._imitate()
                self._begin_finetuning()
            else:
                self._take_up(*saved)
            self._finetune()
            finished = True
        except EnvironmentClosed:
            begun = any(self._folder.checkpoints.iterdir())
            self._journal.message(
                'stopped; a resumed run goes on from here' if begun else
                'stopped before the first checkpoint; a resumed run begins anew')
        return Result(finished, self._state.iteration, self._state.best, self._folder.policy)

    def _fly(self, flights: Sequence[Callable[[], Flight[T]]]) -> Iterator[T]:
        with tensor_threads(1):
            yield from self._fleet.fly(flights, self._poll, self._journal.message)

    def _poll_learning(self) -> None:
        # While most of what an update works with is in use: given back between two updates, it
        # would only be asked for again, and memory go up and down.
        self._give_back()
        self._poll()

    def _poll(self) -> None:
        if self._stop_requested():
            raise EnvironmentClosed('asked to stop')

    def _take_up(self, path: Path, sealed: Sealed) -> None:
        tensors = dict(sealed.tensors)
        self._state = run_state.from_content(path, sealed, self._spec, self._config)
        self._worlds = run_state.take_worlds(path, tensors, len(self._worlds))
        self._learner.load(path, tensors)
        self._folder.go_on_from(path)
        self._journal.take_up(self._state.lines, self._state.steps)
        if self._config.run.episode_lines:
            for line in self._folder.lines():
                self._score_lines.add(line.get('scores', ()))
        try:
            # To hear now whether the simulators take them, and not when there is work to be lost.
            rehearsal.try_snapshots(self._fly, self._worlds)
        except ValueError as error:
            raise ValueError(f'{path}: {error}') from error
        # Some settings may be others now, such as how many episodes are evaluated.
        self._folder.write_config(run_state.description(self._spec, self._config))
        self._keep_best()
        self._journal.keep(saved=f'{path.parent.name}/{path.name}')
        self._begin_stage_finetune()
        self._journal.message(f'resumed from {path.name}')

    def _imitate(self) -> None:
        """Clone the expert into the policy."""
        if self._expert is None:
            return
        imitation = Imitation(
            self._spec, self._config, self._expert, self._fly, self._journal,
            self._poll_learning)
        imitation.teach(self._learner.policy)
        self._state = replace(self._state, steps=self._state.steps + imitation.steps)
        self._learner.critic.normaliser.copy_from(self._learner.policy.normaliser)
        self._save_policy(self._folder.cloned, stage='clone')
        self._tell_saved(self._folder.cloned, news=True)

    def _begin_finetuning(self) -> None:
        """Score the clone, put the world at the first level and save: iteration 0.

        Where there is no clone, there is nothing worth a flight yet.
        """
        self._begin_stage_finetune()
        self._reset_world()
        best: Score | None = None
        numbers: dict[str, Any] = {}
        if self._config.demonstration.demonstration_episodes or self._done():
            best, numbers = self._select()
        numbers |= self._state.reverse.figures()
        self._finish_iteration(best, level=self._state.curriculum.level, **numbers)

    def _begin_stage_finetune(self) -> None:
        self._journal.begin(
            'finetune', self._config.ppo.iterations, self._state.iteration, self._progress())

    def _finetune(self) -> None:
        self._begin_stage_finetune()
        while not self._done():
            state, tensors = self._state, self._tensors()
            try:
                self._iterate()
            except (RuntimeError, TimeoutError, ValueError):
                # Asked to stop, or there is nobody to fly any more: what was learnt is kept.
                self._state = state
                self._save(tensors)
                raise

    def _done(self) -> bool:
        state = self._state
        best = state.best.mean_return if state.best else -math.inf
        return self._ending.reached(state.iteration, state.episodes, best)

    def _progress(self) -> Progress:
        return self._ending.progress(self._state.iteration, self._state.episodes)

    def _iterate(self) -> None:
        """Fly a roll-out, learn from it, and see what follows."""
        iteration, state = self._state.iteration + 1, self._state
        rollout, policy = self._rollout, self._learner.policy

        def begin(group: int) -> Flight[tuple[list[Ended], bytes]]:
            noise = streams.generator(
                self._config.run.seed, 'roll-out', iteration, *later(group))
            return rollout.flight(group, self._begin_rollout(group), policy, noise)

        flown = list(self._fly([
            functools.partial(begin, group) for group in range(len(self._worlds))]))
        self._worlds = [world for _, world in flown]
        episodes = in_order([ended for ended, _ in flown])
        with tensor_threads(self._config.run.threads):
            diagnostics, learning_rate = self._learner.learn(
                iteration, rollout, self._poll_learning)
        outcomes = self._spec.outcomes
        curriculum, reverse = state.curriculum, state.reverse
        if reverse.over:
            curriculum = curriculum.advance(scores.landed(episodes, outcomes))
        else:
            reverse = reverse.advance(scores.landed(self._hardest(flown), outcomes))
        self._state = replace(
            state, iteration=iteration, curriculum=curriculum, reverse=reverse,
            steps=state.steps + rollout.steps,
            episodes=state.episodes + len(episodes))
        message = ''
        if curriculum.level != state.curriculum.level:
            message = f'level {state.curriculum.level} -> {curriculum.level}'
        elif reverse.reach != state.reverse.reach:
            message = (f'the whole task, level {curriculum.level}' if reverse.over else
                       f'reach {state.reverse.reach:.2f} -> {reverse.reach:.2f} m')
        if message:
            self._reset_world()
        best: Score | None = None
        numbers: dict[str, Any] = {}
        if self._done() or self._selects():
            best, numbers = self._select()
        if self._config.run.episode_lines:
            numbers['scores'] = episodes.episode_return.tolist()
            for line in self._score_lines.add(numbers['scores']):
                self._say(line)
        self._finish_iteration(
            best, message, level=state.curriculum.level, learning_rate=learning_rate,
            **state.reverse.figures(), **scores.figures(episodes, outcomes),
            **asdict(diagnostics), **policy.diagnostics(), **numbers)

    @property
    def _whole_episodes(self) -> bool:
        """Whether a roll-out is of whole episodes, from fresh starts."""
        return self._config.ppo.start_copies > 1

    def _begin_rollout(self, group: int) -> Reset | Restore:
        """Return where the next roll-out of a group begins: mostly where the last one ended."""
        if not self._whole_episodes:
            return Restore(self._worlds[group])
        seed = streams.derived_seed(
            self._config.run.seed, 'starts', self._state.iteration, *later(group))
        return Reset(seed, {
            **self._config.curriculum.reset_settings(self._state.curriculum.level, group),
            'spawn_copies': self._config.ppo.start_copies})

    def _hardest(self, flown: Sequence[tuple[list[Ended], bytes]]) -> Episodes:
        """Return the episodes that began highest, of all that ended in a roll-out."""
        return in_order([
            self._state.reverse.hardest(ended, self._world_seed(group))
            for group, (ended, _) in enumerate(flown)])

    def _world_seed(self, group: int) -> int:
        return streams.derived_seed(
            self._config.run.seed, 'world', self._state.reset_iteration, *later(group))

    def _reset_world(self) -> None:
        """Begin new episodes as the curricula have them, and get them out of step."""
        config, pilot = self._config, without_noise(self._learner.policy)
        self._state = replace(self._state, reset_iteration=self._state.iteration)
        level, reach = self._state.curriculum.level, self._state.reverse.reset_settings()
        # Those that begin at all heights are out of step by themselves, and whole episodes need
        # not be.
        scattered = self._state.reverse.over and not self._whole_episodes
        steps = config.ppo.scatter_steps if scattered else 0

        def begin(group: int) -> Flight[bytes]:
            seed = self._world_seed(group)
            settings = {**config.curriculum.reset_settings(level, group), **reach}
            observation = yield Reset(seed, settings)
            yield from scatter(
                self._spec, observation, pilot, steps, np.random.default_rng(seed))
            state: bytes = yield Snapshot()
            return state

        self._worlds = list(self._fly([
            functools.partial(begin, group) for group in range(len(self._worlds))]))
        self._state = replace(self._state, steps=self._state.steps + (
            steps * self._spec.num_envs * len(self._worlds)))

    def _selects(self) -> bool:
        """Tell whether the policy is due for a flight without noise, and worth one."""
        config, least = self._config.run, self._config.run.selection_from_landing_rate
        return self._state.iteration % config.selection_interval == 0 and (
            least == 0 or self._state.curriculum.landing_rate >= least)

    def _select(self) -> tuple[Score | None, dict[str, Any]]:
        """Fly the policy without noise; return its score if it is the best, and numbers."""
        score, steps = fly_selection(
            self._fly, self._spec, self._learner.policy, self._state.iteration,
            self._config.curriculum.selection_settings,
            self._config.run.selection_episodes, self._config.run.seed)
        best = self._state.best
        better = best is None or score.mean_return > best.mean_return
        self._state = replace(
            self._state, steps=self._state.steps + steps, best=score if better else best)
        low, high = wilson(score.landed, score.episodes)
        self._journal.keep(
            selection_iteration=score.iteration, selection_landing_rate_low=low,
            selection_landing_rate_high=high, selection_return=score.mean_return,
            selection_landing_rate=score.landing_rate)
        self._keep_best()
        return score if better else None, {
            'selection_return': score.mean_return, 'selection_landing_rate': score.landing_rate}

    def _keep_best(self) -> None:
        if best := self._state.best:
            self._journal.keep(
                best_iteration=best.iteration, best_landing_rate=best.landing_rate,
                best_return=best.mean_return)

    def _finish_iteration(self, best: Score | None, message: str = '', **numbers: Any) -> None:
        """Write the log's line, and the files that are due."""
        state, config = self._state, self._config
        due = best or self._done() or state.iteration % config.run.checkpoint_interval == 0
        if best:
            message = f'{message}, best policy so far: return {best.mean_return:.1f}'
            message = message.removeprefix(', ')
        self._journal.entry(
            state.iteration, state.steps, message,
            0.0 if self._done() else self._ending.left(state.iteration, state.episodes),
            self._progress(), **numbers)
        self._state = replace(state, lines=self._journal.lines)
        if due:
            self._save(self._tensors(), best)

    def _tensors(self) -> Tensors:
        return {**self._learner.tensors(), **run_state.world_tensors(self._worlds)}

    def _save(self, tensors: Tensors, best: Score | None = None) -> None:
        state = self._state
        content = run_state.content(state, self._spec, self._config)
        written = []
        if best:
            # Before the checkpoint that says they are there: a run that ends in between does this
            # iteration again and writes them again, the same where it computes alike.
            self._folder.save_best(tensors, content)
            self._save_policy(self._folder.policy, **asdict(best))
            written.append(self._folder.policy)
        written.append(self._folder.save(state.iteration, tensors, content))
        self._tell_saved(*written, news=best is not None)

    def _tell_saved(self, *paths: Path, news: bool) -> None:
        """Tell which files are the last; a checkpoint like any other is no news."""
        names = ' and '.join(str(path.relative_to(self._folder.path)) for path in paths)
        self._journal.keep(saved=names)
        self._journal.message(f'saved {names}' if news else '')

    def _save_policy(self, path: Path, **facts: Any) -> None:
        save_policy(
            path, self._learner.policy, self._spec, self._config.network,
            self._config.run.seed,
            {'run': self._folder.name, 'steps': self._state.steps, **facts})


def later(group: int) -> tuple[int, ...]:
    """Return the index of a group for its random streams: the first has those of one alone."""
    return (group,) if group else ()
