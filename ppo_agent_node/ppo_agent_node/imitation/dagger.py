# SPDX-License-Identifier: Apache-2.0
"""Imitation of the expert: demonstrations, behavioural cloning, and rounds of DAgger.

A clone alone drifts into states that no demonstration shows. In each round of DAgger the clone
flies, the expert labels every visited state with its own action, and cloning is repeated on all
samples so far (Ross, Gordon and Bagnell, 'A reduction of imitation learning and structured
prediction to no-regret online learning', AISTATS 2011, algorithm 3.1 with beta = 0).
"""
from __future__ import annotations

import functools
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from dataclasses import asdict
from dataclasses import replace
from typing import Any
from typing import Protocol
from typing import TypeVar

from ppo_agent_node import random_streams
from ppo_agent_node.config.training_config import Config
from ppo_agent_node.flying.episodes import Pilot
from ppo_agent_node.imitation.cloning import CloneEpoch
from ppo_agent_node.imitation.cloning import clone
from ppo_agent_node.imitation.demonstrations import Demonstrations
from ppo_agent_node.imitation.demonstrations import fly_clone
from ppo_agent_node.imitation.demonstrations import fly_wave
from ppo_agent_node.imitation.demonstrations import label
from ppo_agent_node.imitation.demonstrations import start_settings
from ppo_agent_node.ppo.policies.factory import Policy
from ppo_agent_node.ppo.policies.factory import without_noise
from ppo_agent_node.runs import episode_scores
from ppo_agent_node.runs.metrics_logger import MetricsLogger
from ppo_agent_node.threads import tensor_threads
from rocket_sim_node.worlds import Episodes
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.jobs import Job

T = TypeVar('T')


class Fly(Protocol):
    """Runs jobs and yields their results, in order."""

    def __call__(self, flights: Sequence[Callable[[], Job[T]]], /) -> Iterator[T]:
        """Run them."""
        ...


class Imitation:
    """Trains a policy to imitate the expert."""

    def __init__(
        self, spec: WorldSpec, config: Config, expert: Pilot, fly: Fly, metrics: MetricsLogger,
        poll: Callable[[], None],
    ) -> None:
        """Prepare; nothing flies yet.

        :param poll: called before each minibatch, and each step of the expert; may raise to abort.
        """
        self._spec, self._config, self._expert = spec, config, expert
        self._fly, self._metrics, self._poll = fly, metrics, poll
        self.steps = 0
        """Rocket steps taken."""

    def teach(self, policy: Policy) -> None:
        """Demonstrate and clone, then run the rounds of DAgger; the policy is the last clone.

        :raises CloningFailed: when no demonstration landed, or no epoch had a finite loss.
        """
        config = self._config
        rounds = config.demonstration.dagger_rounds
        samples = Demonstrations.join(self._demonstrate())
        epochs = [config.clone.dagger_epochs] * rounds + [config.clone.clone_epochs]
        self._metrics.begin('clone', sum(epochs), unit='epochs')
        done = self._clone(policy, samples, 0, epochs[0], 0, {})
        if rounds:  # the first clone has fitted the normaliser, which does not change any more
            samples = samples.normalised(policy.normaliser)
        for number, count in enumerate(epochs[1:], start=1):
            added, figures = self._fly_clone(policy, number)
            samples = Demonstrations.join([samples, added.normalised(policy.normaliser)])
            done = self._clone(policy, samples, number, count, done, figures)

    def _demonstrate(self) -> list[Demonstrations]:
        """Fly demonstrations by the expert; return the samples of each wave."""
        waves = [
            functools.partial(
                fly_wave, self._spec, self._expert, self._config.demonstration, settings,
                self._config.run.seed, number)
            for number, settings in enumerate(self.starts(self._waves()))]
        self._metrics.begin('demonstrate', len(waves), unit='waves')
        parts = []
        for number, (samples, episodes) in enumerate(self._fly(waves), start=1):
            parts.append(samples)
            self._count(episodes)
            self._metrics.entry(
                number, self.steps, samples=len(samples.episode),
                **episode_scores.figures(episodes, self._spec.outcomes))
        return parts

    def _fly_clone(
        self, policy: Policy, number: int,
    ) -> tuple[Demonstrations, dict[str, Any]]:
        """Fly a round by the clone, labelled with the expert's actions."""
        waves = [
            functools.partial(
                fly_clone, without_noise(policy), settings,
                random_streams.derived_seed(self._config.run.seed, 'dagger', number, wave))
            for wave, settings in enumerate(self.starts(1))]
        flights = list(self._fly(waves))
        episodes = [flight.episodes for flight in flights]
        for flown in episodes:
            self._count(flown)
        found = label(
            self._spec, self._expert, flights, self._config.demonstration.demonstration_episodes,
            self._poll)
        figures = episode_scores.figures(Episodes.concatenate(episodes), self._spec.outcomes)
        rate = figures['landing_rate']
        self._metrics.message(
            f'DAgger round {number}: the clone landed {100 * rate:.1f} %, '
            f'{len(found.episode)} samples added')
        return found, {'dagger_round': number, 'samples': len(found.episode), **figures}

    def _clone(
        self, policy: Policy, samples: Demonstrations, number: int, epochs: int, done: int,
        figures: dict[str, Any],
    ) -> int:
        """Clone all samples; return the number of the stage's epochs done so far."""
        def report(epoch: CloneEpoch) -> None:
            numbers = asdict(epoch)
            first = figures if epoch.epoch == 1 else {}
            self._metrics.entry(
                done + numbers.pop('epoch'), self.steps, **numbers, **first)

        config = self._config
        seed = config.run.seed if not number else random_streams.derived_seed(
            config.run.seed, 'dagger clone', number)
        with tensor_threads(config.run.threads):
            clone(policy, samples, replace(config.clone, clone_epochs=epochs), seed, report,
                  self._poll, normalised=number > 0)
        return done + epochs

    def _waves(self) -> int:
        episodes = self._config.demonstration.demonstration_episodes
        return -(-episodes // self._spec.num_envs)

    def starts(self, waves: int) -> list[dict[str, float]]:
        """Return the reset settings of each wave: as many as planned, then as many wider ones."""
        curriculum = self._config.curriculum
        plain = start_settings(curriculum, self._config.demonstration)
        turned = {name: plain[name] for name in ('spawn_heading',) if name in plain}
        wide = {**curriculum.wide_settings, **curriculum.learning_settings, **turned}
        return [plain] * waves + ([wide] * waves if curriculum.curriculum_wide_level else [])

    def _count(self, episodes: Episodes) -> None:
        self.steps += int(episodes.length.max()) * self._spec.num_envs
