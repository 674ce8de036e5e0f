# SPDX-License-Identifier: Apache-2.0
"""Worlds of a run's groups: resets, roll-outs, and snapshots between them."""
from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from ppo_agent_node import random_streams
from ppo_agent_node.config.training_config import Config
from ppo_agent_node.flying.episodes import scatter
from ppo_agent_node.ppo.episode_rollout import EpisodeRollout
from ppo_agent_node.ppo.policies.factory import Policy
from ppo_agent_node.ppo.policies.factory import without_noise
from ppo_agent_node.ppo.rollout_buffer import Ended
from ppo_agent_node.ppo.rollout_buffer import Rollout
from ppo_agent_node.ppo.rollout_buffer import in_order
from ppo_agent_node.runs.tensor_file import Tensors
from ppo_agent_node.training.preflight import Fly
from ppo_agent_node.training.run_state import RunState
from rocket_sim_node.worlds import Episodes
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.base import NO_EPISODES
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import Restore
from rocket_sim_node.worlds.jobs import Snapshot


class GroupWorlds:
    """State of each group's world."""

    def __init__(self, spec: WorldSpec, config: Config, fly: Fly, ranks: int = 1) -> None:
        """Start without worlds.

        :param fly: runs jobs, job number j on rank j modulo the number of ranks.
        :param ranks: number of ranks; each rolls out only its own groups.
        """
        self._spec, self._config, self._fly, self._ranks = spec, config, fly, ranks
        self.snapshots = [b''] * config.ppo.num_groups
        """Latest snapshot of each group's world."""

    def tensors(self) -> Tensors:
        """Return the snapshots as byte tensors, by name."""
        return {
            _name(group): torch.from_numpy(np.frombuffer(snapshot, np.uint8).copy())
            for group, snapshot in enumerate(self.snapshots)}

    def take(self, path: Path, tensors: Tensors) -> None:
        """Take the snapshots from a checkpoint's tensors.

        :raises ValueError: when one is missing; names the file.
        """
        names = [_name(group) for group in range(len(self.snapshots))]
        for name in names:
            if name not in tensors:
                raise ValueError(f'{path}: has no tensor {name!r}')
        self.snapshots = [tensors.pop(name).numpy().tobytes() for name in names]

    def reset(self, policy: Policy, state: RunState) -> int:
        """Start new episodes according to the curricula, and spread the rockets over their phases.

        :return: rocket steps taken.
        """
        config, pilot = self._config, without_noise(policy)
        level = state.curriculum.level
        # Starts at all heights are spread already, and roll-outs of whole episodes do not need it.
        scattered = state.reverse.over and not config.ppo.whole_episodes
        steps = config.ppo.scatter_steps if scattered else 0

        def begin(group: int) -> Job[bytes]:
            seed = self._seed(state, group)
            settings = {
                **config.curriculum.reset_settings(level, group),
                **state.reverse.reset_settings(group)}
            observation = yield Reset(seed, settings)
            yield from scatter(
                self._spec, observation, pilot, steps, np.random.default_rng(seed))
            snapshot: bytes = yield Snapshot()
            return snapshot

        self.snapshots = list(self._fly([
            functools.partial(begin, group) for group in range(len(self.snapshots))]))
        return steps * self._spec.num_envs * len(self.snapshots)

    def roll_out(
        self, rollout: Rollout | EpisodeRollout, policy: Policy, state: RunState,
    ) -> list[list[Ended]]:
        """Run the roll-out of the next iteration; return the episodes that ended in each group."""
        def begin(group: int) -> Job[tuple[list[Ended], bytes]]:
            noise = random_streams.generator(
                self._config.run.seed, 'roll-out', state.iteration + 1, *_later(group))
            return rollout.flight(
                group // self._ranks, self._begin(group, state), policy, noise)

        flown = list(self._fly([
            functools.partial(begin, group) for group in range(len(self.snapshots))]))
        self.snapshots = [snapshot for _, snapshot in flown]
        return [ended for ended, _ in flown]

    def _begin(self, group: int, state: RunState) -> Reset | Restore:
        """Return how the next roll-out of a group begins: usually at the end of the last one."""
        config = self._config
        if not config.ppo.whole_episodes:
            return Restore(self.snapshots[group])
        seed = random_streams.derived_seed(
            config.run.seed, 'starts', state.iteration, *_later(group))
        return Reset(seed, {
            **config.curriculum.reset_settings(state.curriculum.level, group),
            'spawn_copies': config.ppo.start_copies})

    def judged(self, flown: Sequence[Sequence[Ended]]) -> Episodes:
        """Return the episodes of a roll-out by which the level is judged, oldest first.

        Those of the groups that fly `curriculum_wide_level` do not count. Whole episodes are
        equally old. By their ends, those that crash early would be the oldest and leave the window
        of the curriculum. So they are ordered by copy and rocket, which does not depend on them.
        """
        wide, copies = self._config.curriculum.curriculum_wide_level, self._config.ppo.start_copies
        episodes = in_order(flown[::2] if wide else flown)
        if not self._config.ppo.whole_episodes:
            return episodes
        return episodes.take(np.lexsort((episodes.row, episodes.row % copies)))

    def hardest(self, flown: Sequence[Sequence[Ended]], state: RunState) -> Episodes:
        """Return the episodes with the highest starts, of all that ended in a roll-out.

        Empty without an active reverse curriculum.
        """
        if state.reverse.over:
            return NO_EPISODES
        return in_order([
            state.reverse.hardest(ended, self._seed(state, group))
            for group, ended in enumerate(flown)])

    def _seed(self, state: RunState, group: int) -> int:
        """Return the seed of the last reset of a group's world."""
        return random_streams.derived_seed(
            self._config.run.seed, 'world', state.reset_iteration, *_later(group))


def _name(group: int) -> str:
    return f'world.{group}' if group else 'world'


def _later(group: int) -> tuple[int, ...]:
    """Return a group's index for its random streams; empty for the first, as in a run of one."""
    return (group,) if group else ()
