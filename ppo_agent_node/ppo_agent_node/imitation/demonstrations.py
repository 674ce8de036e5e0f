# SPDX-License-Identifier: Apache-2.0
"""Demonstrations: observations labelled with the expert's actions."""
from __future__ import annotations

import copy
import sys
from collections.abc import Callable
from collections.abc import Mapping
from collections.abc import Sequence
from typing import Any
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ppo_agent_node import random_streams
from ppo_agent_node.config.curriculum_config import CurriculumConfig
from ppo_agent_node.config.imitation_config import UNSET
from ppo_agent_node.config.imitation_config import DemonstrationConfig
from ppo_agent_node.flying.episodes import Pilot
from ppo_agent_node.flying.episodes import Step
from ppo_agent_node.flying.episodes import fly_once
from ppo_agent_node.flying.pilot import tell_begun
from ppo_agent_node.flying.pilot import tell_flown
from ppo_agent_node.ppo.networks.mlp import Normaliser
from rocket_sim_node.worlds import Episodes
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.base import Bools
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.planar.vehicle import foot_height

_TOUCH = 1e-5
"""m above the ground at which a foot counts as touching, as observations are rounded."""


class Demonstrations(NamedTuple):
    """Samples of episodes, one episode after the other."""

    observation: Tensor
    """`(S, D)`."""
    action: Tensor
    """`(S, *action_shape)`, the expert's actions, within their bounds."""
    episode: Tensor
    """`(S,)` index of the kept episode, from 0, ascending."""

    @classmethod
    def join(cls, parts: list[Demonstrations]) -> Demonstrations:
        """Concatenate waves, with consecutive episode numbers."""
        episodes, first = [], 0
        for part in parts:
            episodes.append(part.episode + first)
            first += int(part.episode[-1]) + 1 if len(part.episode) else 0
        return cls(
            torch.cat([part.observation for part in parts]),
            torch.cat([part.action for part in parts]), torch.cat(episodes))

    def normalised(self, normaliser: Normaliser) -> Demonstrations:
        """Return them with normalised observations and features, `(S, D + F)`."""
        return self._replace(observation=normaliser.of_many(self.observation))


def spawn_settings(config: DemonstrationConfig, level: int) -> dict[str, float]:
    """Return the reset settings of demonstrations: the level, or wider if so configured.

    A world without levels has only one of these ranges, `spawn_reach`.
    """
    wider = {
        name.removeprefix('demonstration_'): getattr(config, name)
        for name in config.__dataclass_fields__ if name.startswith('demonstration_spawn_')
    }
    chosen = {name: value for name, value in wider.items() if value != UNSET}
    if not level:
        return {name: value for name, value in chosen.items() if name == 'spawn_reach'}
    return {'level': level, **chosen}


def start_settings(curriculum: CurriculumConfig, config: DemonstrationConfig) -> dict[str, float]:
    """Return all reset settings of demonstrations: those of the task, or wider starts."""
    final = curriculum.curriculum_final_level
    return {
        **curriculum.task_settings(final), **curriculum.learning_settings,
        **spawn_settings(config, final)}


def touching(observation: F32, settings: Mapping[str, float]) -> Bools:
    """Return which rockets touch the ground, `(N,)`, according to their observations.

    :param observation: `(N, 15)` of a world of rockets with feet.
    :param settings: of that world.
    """
    seen = observation.astype(np.float64)
    lean = np.hypot(seen[:, 6], seen[:, 8])
    foot = foot_height(seen[:, 1] * settings['position_scale'], lean, seen[:, 7], settings)
    return np.asarray(foot <= _TOUCH)


def steered(steps: Sequence[Step], settings: Mapping[str, float]) -> Bools:
    """Return which actions had an effect, `(N, T)`: a rocket is not controlled after touchdown.

    If its contact switch cuts the engine, the expert's later actions mean nothing, and learning
    them would make the policy less accurate in the last metre.
    """
    if 'stance' not in settings or not settings['engine_cutoff']:
        return np.ones((len(steps[0].flying), len(steps)), np.bool_)
    touched = np.stack([touching(step.observation, settings) for step in steps], axis=1)
    return ~np.logical_or.accumulate(touched, axis=1)


def usable_engine(steps: Sequence[Step], settings: Mapping[str, float]) -> Bools:
    """Return in which steps the engine burned or could still be lit, `(N, T)`.

    After its last ignition it stays off whatever the command. A teacher that does not know this
    keeps commanding thrust. A falling rocket that has used up its ignitions looks like one whose
    engine has yet to be lit, so such samples would teach the policy to ignite too early.

    :param steps: with the actions applied.
    :param settings: of the world; `ignitions` 0 allows any number, and all steps are usable.
    """
    most = settings.get('ignitions', 0)
    if not most:
        return np.ones((len(steps[0].flying), len(steps)), np.bool_)
    asked = np.stack([(step.action[:, 0] + 1) / 2 for step in steps], axis=1)
    lit = asked > settings['throttle_cutoff']
    before = np.pad(lit, ((0, 0), (1, 0)))[:, :-1]
    ignitions = np.pad(np.cumsum(lit & ~before, axis=1), ((0, 0), (1, 0)))[:, :-1]
    usable: Bools = (ignitions < most) | before & (ignitions == most)
    return usable


def fly_wave(
    spec: WorldSpec, expert: Pilot, config: DemonstrationConfig, settings: Mapping[str, float],
    seed: int, wave: int,
) -> Job[tuple[Demonstrations, Episodes]]:
    """Fly one episode with each rocket by the expert and keep those that landed.

    Where there are more rockets than `demonstration_episodes`, the first ones count.

    Noise on the applied actions shows how the expert recovers (Laskey et al., 'DART: noise
    injection for robust imitation learning', 2017); the labels are the expert's own actions.

    :param settings: reset settings of the world.
    :return: the samples of landed episodes, and all episodes.
    """
    noise = np.random.default_rng(random_streams.derived_seed(seed, 'demonstration noise', wave))

    def disturb(action: NDArray[Any]) -> NDArray[Any]:
        if not config.demonstration_noise or not spec.continuous:
            return action
        wanted = action + config.demonstration_noise * noise.standard_normal(action.shape)
        flown = wanted.astype(np.float32)
        tell_flown(pilot, flown)
        return flown

    observation = yield Reset(
        random_streams.derived_seed(seed, 'demonstrations', wave), settings)
    pilot = copy.deepcopy(expert)  # in its initial state, also when the job is restarted
    tell_begun(pilot)
    steps = yield from fly_once(observation, pilot, disturb)
    episodes = Episodes.concatenate([step.episodes for step in steps])
    landed = np.zeros(spec.num_envs, np.bool_)
    landed[episodes.row[episodes.outcome == spec.outcomes.index('landed')]] = True
    landed[config.demonstration_episodes:] = False
    return _samples(spec, steps, landed), episodes


class CloneFlight(NamedTuple):
    """A flight of a clone: one episode of each rocket."""

    settings: Mapping[str, float]
    """Of the reset with which it began."""
    steps: list[Step]

    @property
    def episodes(self) -> Episodes:
        """The episodes, in the order of their ends."""
        return Episodes.concatenate([step.episodes for step in self.steps])


def fly_clone(pilot: Pilot, settings: Mapping[str, float], seed: int) -> Job[CloneFlight]:
    """Fly one episode with each rocket by a clone.

    :param settings: reset settings of the world.
    """
    observation = yield Reset(seed, settings)
    return CloneFlight(settings, (yield from fly_once(observation, pilot)))


def label(
    spec: WorldSpec, expert: Pilot, flights: Sequence[CloneFlight], most: int = sys.maxsize,
    poll: Callable[[], None] = lambda: None,
) -> Demonstrations:
    """Return the observations of flights with the expert's actions, flight by flight.

    All episodes are kept, whatever their outcome: the clone must learn where it fails. Steps are
    dropped after a touchdown and where the engine can no longer be lit (`usable_engine`).

    :param most: number of rockets of a flight that count, the first ones.
    :param poll: called before each step; may raise to abort.
    """
    chosen = np.arange(spec.num_envs) < most
    parts = []
    for flight, actions in zip(flights, _labels(expert, flights, poll), strict=True):
        labelled = [step._replace(action=action)
                    for step, action in zip(flight.steps, actions, strict=False)]
        usable = usable_engine(flight.steps, spec.after_reset(flight.settings).settings)
        parts.append(_samples(spec, labelled, chosen, usable))
    return Demonstrations.join(parts)


def _labels(
    expert: Pilot, flights: Sequence[CloneFlight], poll: Callable[[], None],
) -> list[list[NDArray[Any]]]:
    """Return the expert's actions `(N, ...)` in the steps of each flight.

    The expert sees the flights as one batch, because most of the time of a call does not depend
    on the number of rockets. A flight that is over stays where it ended, with actions that mean
    nothing.
    """
    expert = copy.deepcopy(expert)
    tell_begun(expert)
    found: list[list[NDArray[Any]]] = [[] for _ in flights]
    for number in range(max(len(flight.steps) for flight in flights)):
        poll()
        now = [flight.steps[min(number, len(flight.steps) - 1)] for flight in flights]
        action = expert(np.concatenate([step.observation for step in now]))
        for actions, part in zip(found, np.split(action, len(flights)), strict=True):
            actions.append(part)
        tell_flown(expert, np.concatenate([step.action for step in now]))
        tell_begun(expert, np.concatenate([
            step.ended + place * len(step.flying) for place, step in enumerate(now)]))
    return found


def _samples(
    spec: WorldSpec, steps: Sequence[Step], chosen: Bools, usable: Bools | None = None,
) -> Demonstrations:
    """Return the samples of selected rockets `(N,)`, rocket by rocket.

    :param usable: `(N, T)`, which steps count; by default all.
    """
    # (N, T) before flattening.
    kept = np.stack([step.flying & chosen for step in steps], axis=1)
    if usable is not None:
        kept &= usable
    kept &= steered(steps, spec.settings)
    action = np.stack([step.action for step in steps], axis=1)[kept]
    if spec.continuous:
        action = np.clip(action, spec.action_low, spec.action_high, dtype=np.float32)
    else:
        action = action.astype(np.int64)
    return Demonstrations(
        torch.from_numpy(np.stack([step.observation for step in steps], axis=1)[kept]),
        torch.from_numpy(action),
        torch.from_numpy((np.cumsum(chosen) - 1)[np.nonzero(kept)[0]]))
