# SPDX-License-Identifier: Apache-2.0
"""Command `failures`: flies the failed starts of an evaluation again and records them."""
from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.flying.pilot import tell_begun
from ppo_agent_node.pilots import choice
from ppo_agent_node.pilots.choice import POLICY
from ppo_agent_node.reporting.run_files import LARGEST
from rocket_sim_node import command_line
from rocket_sim_node import input_file
from rocket_sim_node import worlds
from rocket_sim_node.printable import printable_path
from rocket_sim_node.recording.recorder import Recorder
from rocket_sim_node.recording.sinks.destinations import check_suffix
from rocket_sim_node.recording.sinks.file_sink import FileSink
from rocket_sim_node.recording.trajectories import touchdown
from rocket_sim_node.recording.trajectories.filter import RecordingFilter
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.settings import setting
from rocket_sim_node.telemetry.capture import Telemetry
from rocket_sim_node.telemetry.capture import joined
from rocket_sim_node.telemetry.samples import Samples
from rocket_sim_node.worlds.base import SimulatedWorld

Start = tuple[int, int]
"""Row and episode."""


@dataclass(frozen=True)
class Failures:
    """Arguments of the command."""

    run_dir: str = setting('', '', 'folder of the evaluation, or of the run that was evaluated')
    output: str = setting('', '', 'the recording, .rrd; empty: failures.rrd in that folder')


def make(wanted: Failures) -> str:
    """Write the recording; return the text to print.

    :raises OSError: when there is no evaluation, no policy, or the recording cannot be written.
    :raises ValueError: when an argument or a file does not fit.
    """
    if not wanted.run_dir:
        raise ValueError('run_dir: got none, expected the folder of an evaluation')
    folder = Path(wanted.run_dir)
    output = Path(wanted.output) if wanted.output else folder / 'failures.rrd'
    check_suffix(wanted.output or output)
    path = folder / 'evaluation.json'
    text = input_file.read_text(path, LARGEST)
    try:
        figures = json.loads(text)
        starts = [(int(one['row']), int(one['episode'])) for one in figures['failed_starts']]
        if not starts:
            return f'{path}: all episodes landed, there is nothing to record\n'
        settings = worlds.settings_from(figures['world'], figures['world_settings'])
        world = worlds.make(figures['world'], figures['num_envs'], 0, **settings)
        seed = int(figures['seed'])
        pilot = _pilot(folder, figures, world)
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
        raise ValueError(f'{path}: damaged, or of an earlier version: {error!r}') from error
    flown = fly_again(world, pilot, seed, starts)
    record(output, world, flown)
    outcomes = ', '.join(
        f'{one["outcome"]} (rocket {one["row"]}, episode {one["episode"]})'
        for one in figures['failed_starts'])
    return (f'{outcomes}\nfailures: {printable_path(output)}; '
            f'watch it with: {command_line.watch_with(output)}\n')


def _pilot(folder: Path, figures: dict[str, Any], world: SimulatedWorld) -> Pilot:
    """Return the evaluated pilot.

    :raises FileNotFoundError: when the file of the pilot no longer exists.
    :raises ValueError: when the file has changed.
    """
    name, file = figures['policy'], figures.get('policy_file')
    if name != POLICY and not file:
        # Variants of the expert have names of their own, such as that for the lander.
        known = name if name in choice.NAMES else choice.EXPERT
        return choice.choose(known, world.spec, figures['seed']).pilot
    path = Path(file or folder / 'policy.safetensors')
    chosen = choice.choose(str(path.resolve()), world.spec)
    expected = figures.get('policy_sha256')
    if expected and hashlib.sha256(path.read_bytes()).hexdigest() != expected:
        raise ValueError(f'{path}: is not the policy that was evaluated')
    return chosen.pilot


def fly_again(
    world: SimulatedWorld, pilot: Pilot, seed: int, starts: Sequence[Start],
) -> Samples:
    """Return every step of selected episodes of an evaluation, with z up.

    The whole batch flies again, so that the episodes are identical, bit for bit.

    :param world: with the evaluation's number of rockets and settings.
    :param starts: one or more.
    """
    wanted = set(starts)
    rows = np.unique([row for row, _ in starts])
    left = set(wanted)

    def chosen(states: Telemetry) -> Telemetry:
        both = zip(states.row.tolist(), states.episode.tolist(), strict=True)
        return states.take(np.array([start in wanted for start in both], np.bool_))

    observation = world.reset(seed)
    tell_begun(pilot)
    parts = [(0, chosen(world.telemetry(rows)))]
    step = 0
    while left:
        observation, _, _, _, info = world.step(pilot(observation))
        tell_begun(pilot, info['final_rows'])
        step += 1
        ended = chosen(world.finished)
        left -= set(zip(ended.row.tolist(), ended.episode.tolist(), strict=True))
        parts += [(step, ended), (step, chosen(world.telemetry(rows)))]
    return joined(parts)


def record(path: Path, world: SimulatedWorld, samples: Samples) -> None:
    """Write a recording of flights.

    :raises OSError: when it cannot be written.
    """
    spec = world.spec
    recorder = Recorder(
        RecordingFilter(rows=tuple(np.unique(samples.row).tolist())),
        [FileSink(path, lambda *note: None)], lambda *note: None, settle=touchdown.follow)
    recorder.world(WorldInfo.of(spec))
    recorder.states(1, samples)
    recorder.close()


def main() -> None:
    """Run the command."""
    command_line.run(
        'failures', 'run_dir:=DIR [NAME:=VALUE ...]',
        'Repeats the failed episodes that evaluation.json lists and records them, sorted by '
        'outcome.', Failures, make)


if __name__ == '__main__':
    main()
