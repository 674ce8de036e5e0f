# SPDX-License-Identifier: Apache-2.0
"""Checks before a run that its simulators accept its resets and snapshots."""
from __future__ import annotations

import functools
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ppo_agent_node.config.training_config import Config
from ppo_agent_node.imitation.demonstrations import start_settings
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import Restore

Fly = Callable[[Sequence[Callable[[], Job[Any]]]], Iterator[Any]]
"""Runs jobs, see `worlds.jobs.Fleet`."""


def try_starts(fly: Fly, config: Config) -> None:
    """Start episodes with each kind of reset of a new run.

    :raises ValueError: for starts that the simulator refuses; says whose.
    """
    curriculum, demonstration = config.curriculum, config.demonstration
    first, final = curriculum.curriculum_start_level, curriculum.curriculum_final_level
    starts = {f'curriculum, level {level}': curriculum.reset_settings(level)
              for level in (first, final)}
    if curriculum.curriculum_wide_level:
        starts['curriculum_wide_level'] = curriculum.reset_settings(final, group=1)
    if curriculum.curriculum_start_reach:
        starts['curriculum_start_reach'] = {  # of the final level, which leans most
            **curriculum.reset_settings(final), 'spawn_reach': curriculum.curriculum_start_reach}
    if demonstration.demonstration_episodes:
        starts['demonstrations'] = start_settings(curriculum, demonstration)
    for whose, settings in starts.items():
        try:
            list(fly([functools.partial(_begin, settings)]))
        except ValueError as error:
            raise ValueError(f'{whose}: {error}') from error


def try_snapshots(fly: Fly, path: Path, worlds: Sequence[bytes]) -> None:
    """Restore the snapshots from which a resumed run continues.

    :param path: of the file that contains them.
    :raises ValueError: for one that the simulator refuses; names the file.
    """
    try:
        list(fly([functools.partial(_go_into, world) for world in worlds]))
    except ValueError as error:
        raise ValueError(f'{path}: {error}') from error


def _begin(settings: dict[str, float]) -> Job[None]:
    yield Reset(0, settings)


def _go_into(world: bytes) -> Job[None]:
    yield Restore(world)
