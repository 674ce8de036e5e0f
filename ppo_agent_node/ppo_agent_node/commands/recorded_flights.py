# SPDX-License-Identifier: Apache-2.0
"""Flights of several pilots from the same starts, recorded step by step in this process."""
from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.flying.pilot import tell_begun
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.pilots.scripted import scripted_pilot
from ppo_agent_node.runs.config_file import read_config
from rocket_sim_node import worlds
from rocket_sim_node.recording.comparison.comparison import Side
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.trajectory import TrajectoryBuffer
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.telemetry.capture import Telemetry
from rocket_sim_node.telemetry.capture import joined
from rocket_sim_node.telemetry.samples import Samples
from rocket_sim_node.worlds.base import SimulatedWorld
from rocket_sim_node.worlds.rocket import conditions


@dataclass(frozen=True)
class RecordedRun:
    """World and pilots of a run, from the files in its folder."""

    path: Path
    world: str
    settings: Mapping[str, float]
    level: int
    """Final level of the curriculum, 0 in worlds without levels."""
    seed: int
    """First seed of its evaluation."""
    taught: bool
    """Whether an expert demonstrated."""


def read_run(path: Path) -> RecordedRun:
    """Return the properties of a run.

    :raises FileNotFoundError: when there is no run in that folder.
    :raises ValueError: when its `config.yaml` is damaged.
    """
    config = path / 'config.yaml'
    if not config.is_file():
        raise FileNotFoundError(2, 'not the folder of a run, expected a config.yaml', str(path))
    values = read_config(config)
    try:
        training = values['training']
        world = str(values['world'])
        # A run resets its world to its own conditions, regardless of the simulator's.
        drawn = training.get('conditions')
        return RecordedRun(
            path, world, {
                **worlds.settings_from(world, values['world_settings']),
                **(conditions.settings(drawn) if drawn else {})},
            int(training['curriculum_final_level']), int(training['evaluation_seed']),
            int(training['demonstration_episodes']) > 0)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f'{config}: damaged: {error!r}') from error


def make_world(run: RecordedRun, episodes: int, level: int) -> SimulatedWorld:
    """Return the run's world, with a vehicle for each episode.

    :param level: of the curriculum; 0 without levels.
    :raises ValueError: for a level that the world does not have.
    """
    settings: dict[str, Any] = dict(run.settings)
    if level:
        if 'level' not in worlds.reset_settings(run.world):
            raise ValueError(f'level: got {level}, expected 0, as world {run.world} has no levels')
        settings['level'] = level
    return worlds.make(run.world, episodes, 0, **settings)


def pilots(
    run: RecordedRun, world: SimulatedWorld,
) -> tuple[list[tuple[str, str, str, Pilot]], list[str]]:
    """Return a run's pilots as (key, name, title, pilot), and remarks on missing ones.

    Keys begin with a number, as the viewer sorts by them.

    :raises FileNotFoundError: when the run has no policy yet.
    :raises ValueError: when a policy is damaged or does not fit the world.
    """
    policy, cloned = run.path / 'policy.safetensors', run.path / 'cloned.safetensors'
    if not policy.is_file():
        raise FileNotFoundError(2, 'the run has no policy yet', str(policy))
    if not run.taught:
        return [
            ('1_heuristic', 'heuristic', 'Heuristic, scripted', scripted_pilot(world.spec)),
            ('2_trained', 'trained', 'Trained by PPO', PolicyPilot(policy, world.spec)),
        ], ['This run learnt without demonstrations: there is no clone to compare.']
    who: list[tuple[str, str, str, Pilot]] = [
        ('1_expert', 'expert', 'Expert, scripted', scripted_pilot(world.spec))]
    remarks = []
    if cloned.is_file():
        who.append((
            '2_cloned', 'cloned', 'Cloned from demonstrations, before PPO',
            PolicyPilot(cloned, world.spec)))
    else:
        remarks.append(
            'This run has no `cloned.safetensors`: the version that made it kept no clone.')
    who.append((
        f'{len(who) + 1}_best', 'best', 'The best policy of the run',
        PolicyPilot(policy, world.spec)))
    return who, remarks


def fly(world: SimulatedWorld, pilot: Pilot, seed: int) -> Samples:
    """Return every step of each vehicle's first episode from a seed, with z up.

    The start of a row depends on seed and row alone, so it is the same for every pilot.

    :raises ValueError: for a seed out of range.
    """
    observation = world.reset(seed)
    tell_begun(pilot)
    flying = np.arange(world.spec.num_envs)
    parts: list[tuple[int, Telemetry]] = [(0, world.telemetry(flying))]
    step = 0
    while flying.size:
        observation, _, _, _, info = world.step(pilot(observation))
        tell_begun(pilot, info['final_rows'])
        step += 1
        ended = world.finished.take(np.flatnonzero(np.isin(world.finished.row, flying)))
        flying = np.setdiff1d(flying, ended.row)
        parts += [(step, ended), (step, world.telemetry(flying))]
    return joined(parts)


def flights(samples: Samples, outcomes: Sequence[str]) -> tuple[Trajectory, ...]:
    """Return samples of whole episodes, one per row, as trajectories in the order of the rows."""
    found = []
    for row in np.unique(samples.row).tolist():
        mine = samples.take(np.flatnonzero(samples.row == row))
        buffer = TrajectoryBuffer()
        buffer.extend(mine)
        found.append(buffer.finish(row, outcomes[int(mine.outcome[-1])]))
    return tuple(found)


def compare(
    run: RecordedRun, episodes: int, level: int, seed: int,
) -> tuple[list[Side], WorldInfo, Sequence[str]]:
    """Fly all pilots of a run from the same starts.

    :return: the flights of each pilot, the world's properties, and remarks on missing pilots.
    :raises FileNotFoundError: when the run has no policy yet.
    :raises ValueError: for a level, a seed or a policy that does not fit.
    """
    world = make_world(run, episodes, level)
    who, remarks = pilots(run, world)
    sides, spec = [], world.spec
    for key, name, title, pilot in who:
        flown = flights(fly(world, pilot, seed), spec.outcomes)
        sides.append(Side(key, name, title, flown))
    return sides, WorldInfo.of(spec), remarks
