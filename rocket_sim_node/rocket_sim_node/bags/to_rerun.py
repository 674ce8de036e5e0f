# SPDX-License-Identifier: Apache-2.0
"""Conversion of a bag to a recording for Rerun: `python -m rocket_sim_node.bags.to_rerun BAG`."""
from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from rocket_sim_node import settings
from rocket_sim_node.bags.metadata import read_metadata
from rocket_sim_node.bags.reader import STATE
from rocket_sim_node.bags.reader import TRAINING
from rocket_sim_node.bags.reader import WORLD
from rocket_sim_node.bags.reader import Recorded
from rocket_sim_node.bags.reader import UnknownFields
from rocket_sim_node.bags.reader import known_fields
from rocket_sim_node.bags.reader import messages
from rocket_sim_node.recording.drawing.training_plots import training_of
from rocket_sim_node.recording.recorder import Recorder
from rocket_sim_node.recording.sinks.destinations import Note
from rocket_sim_node.recording.sinks.destinations import check_suffix
from rocket_sim_node.recording.sinks.file_sink import FileSink
from rocket_sim_node.recording.sinks.rerun_program import ViewerError
from rocket_sim_node.recording.trajectories import touchdown
from rocket_sim_node.recording.trajectories.filter import RecordingFilter
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.telemetry.quantities import NO_OUTCOME
from rocket_sim_node.telemetry.samples import samples_of

_TICK = 1_000_000_000
"""ns of the bag's time between two looks at what has waited long enough."""


def convert(
    bag: Path, output: Path, selection: RecordingFilter, note: Note, namespace: str = '',
) -> int:
    """Write the flights and the training of a bag as `rerun_recorder` would have.

    :param bag: folder of the bag, or its file.
    :param output: the recording, .rrd.
    :param selection: the flights wanted.
    :param namespace: of the simulator, such as /sim_0.
    :return: number of flights.
    :raises ValueError: when it is no bag, or is damaged, or `output` does not end with .rrd.
    :raises OSError: when the recording cannot be written.
    """
    check_suffix(output)
    space = namespace.rstrip('/')
    if bag.is_dir():  # before anything is written
        _check_space({
            one['topic_metadata']['name'].rpartition('/')[0]
            for one in read_metadata(bag)['topics_with_message_count']
            if one['topic_metadata']['type'] == STATE and one['message_count']}, space)
    now = 0
    recorder = Recorder(
        selection, [FileSink(output.absolute(), note)], note, clock=lambda: now / 1e9,
        settle=touchdown.follow)
    looked = ended = 0
    spaces: set[str] = set()
    try:
        for one in messages(bag, types=(WORLD, STATE, TRAINING)):
            now = one.received
            found = one.topic.rpartition('/')[0]
            if one.type_name == STATE or found == space:
                spaces.add(found)
            if one.type_name == TRAINING or found == space:
                ended += _take(recorder, one, note)
            if now - looked >= _TICK:
                looked = now
                recorder.tick()
    finally:
        recorder.close()
    _check_space(spaces, space)
    if ended > recorder.flights:
        note('WARN', f'{ended - recorder.flights} flights are left out: of other rockets, while '
                     'an agent learns, beyond the maximum of steps, or with missing steps')
    return recorder.flights


def _take(recorder: Recorder, one: Recorded, note: Note) -> int:
    """Pass a message on to a recorder; return the number of flights that end in it."""
    try:
        with known_fields(one):
            pass_on, ended = _call(recorder, one)
        pass_on()
    except UnknownFields:
        raise
    except (ValueError, ArithmeticError, LookupError) as error:
        note('WARN', f'{one.topic} ignored: {error}')
        return 0
    return ended


def _call(recorder: Recorder, one: Recorded) -> tuple[Callable[[], None], int]:
    """Return the call that passes on a message, and the number of flights that end in it."""
    if one.type_name == TRAINING:
        return partial(recorder.training, training_of(one.message)), 0
    if one.type_name == WORLD:
        return partial(recorder.world, _info(one.message)), 0
    samples = samples_of(one.message)
    return (partial(recorder.states, one.message.session, samples),
            int((samples.outcome != NO_OUTCOME).sum()))


def _check_space(spaces: set[str], space: str) -> None:
    """Check that a simulator's namespace is one of those with states, if there are any.

    :raises ValueError: naming them.
    """
    if spaces and space not in spaces:
        raise ValueError(
            f'namespace: got {space!r}, expected one of those with states in this bag: '
            f'{", ".join(sorted(spaces))}')


def _info(message: Any) -> WorldInfo:
    """Return the properties of a world from its description.

    :raises ValueError: when the description is not valid.
    """
    dt, outcomes = float(message.dt), tuple(message.outcomes)
    if not dt > 0.0 or not outcomes:
        raise ValueError(f'dt {dt}, outcomes {outcomes}: expected a time and names')
    constants = {one.name: one.value for one in (*message.settings, *message.replaced)}
    return WorldInfo.build(
        message.world, dt, outcomes, constants, tuple(message.condition_names))


def main(argv: list[str] | None = None) -> int:
    """Convert the bag that the command line names."""
    parser = argparse.ArgumentParser(
        prog='python -m rocket_sim_node.bags.to_rerun',
        description='Converts a bag (MCAP) to a recording for Rerun.')
    parser.add_argument('bag', type=Path, help='folder of the bag, or its .mcap file')
    parser.add_argument(
        'output', type=Path, nargs='?', help='the recording, .rrd; default: beside the bag')
    parser.add_argument(
        '--namespace', default='', help='namespace of the simulator, e.g. /sim_0 (default: none)')
    infos = settings.describe(RecordingFilter)
    for info in infos:
        option = f'--{info.name.replace("_", "-")}'
        if isinstance(info.default, bool):
            parser.add_argument(option, action='store_true', help=info.description)
        else:
            parser.add_argument(
                option, type=int, default=info.default, help=f'{info.description} (default: '
                '%(default)s)', nargs='+' if isinstance(info.default, tuple) else None)
    given = parser.parse_args(argv)
    whole = Path(os.path.abspath(given.bag))  # `.` has no name

    def note(level: str, text: str) -> None:
        sys.stderr.write(f'{text}\n' if level == 'INFO' else f'{level}: {text}\n')

    try:
        selection = settings.build(
            RecordingFilter, {info.name: getattr(given, info.name) for info in infos})
        flights = convert(
            given.bag, given.output or whole.with_name(f'{whole.name}.rrd'), selection, note,
            given.namespace)
    except (ValueError, OSError, ViewerError) as error:
        sys.stderr.write(f'to_rerun: {error}\n')
        return 2
    sys.stderr.write(f'{flights} flights\n')
    return 0


if __name__ == '__main__':
    sys.exit(main())
