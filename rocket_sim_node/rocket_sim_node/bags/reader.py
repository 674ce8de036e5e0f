# SPDX-License-Identifier: Apache-2.0
"""Reader of bags: their messages, and the flights on topic `state` as arrays. It needs no ROS."""
from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Mapping
from collections.abc import Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rocket_sim_node import input_file
from rocket_sim_node.bags import mcap_file
from rocket_sim_node.bags.decoder import Decoder
from rocket_sim_node.bags.metadata import FILE
from rocket_sim_node.bags.metadata import read_metadata
from rocket_sim_node.bags.read_errors import DAMAGED
from rocket_sim_node.recording.trajectories.trajectory import Trajectory
from rocket_sim_node.recording.trajectories.trajectory import TrajectoryBuffer
from rocket_sim_node.telemetry.quantities import NO_OUTCOME
from rocket_sim_node.telemetry.samples import Samples
from rocket_sim_node.telemetry.samples import samples_of

LARGEST = 64 * 2**30
"""Maximum bytes of a bag's file."""
STATE, WORLD, TRAINING = (
    f'rocket_msgs/msg/{name}' for name in ('RocketState', 'World', 'TrainingStatus'))


@dataclass(frozen=True)
class Recorded:
    """A message of a bag: `received` and `published` are ns since the epoch."""

    topic: str
    type_name: str
    received: int
    published: int
    message: Any


def files_of(path: Path | str) -> list[Path]:
    """Return the MCAP files of a bag: of its folder, or the file itself.

    :raises ValueError: when it is no bag, or one of its files cannot be.
    :raises OSError: when a file is missing or cannot be read.
    """
    path = Path(path)
    if path.is_file() and path.suffix == '.mcap':
        files = [path]
    elif (path / FILE).is_file():
        files = [path / Path(name).name for name in read_metadata(path)['relative_file_paths']]
    else:
        raise ValueError(f'{path}: expected a bag, a folder with {FILE}, or a file .mcap')
    for file in files:
        input_file.check(file, LARGEST)
    return files


def messages(
    path: Path | str, topics: Sequence[str] | None = None, types: Sequence[str] | None = None,
) -> Iterator[Recorded]:
    """Yield the messages of a bag in the order in which they were received.

    :param path: folder of the bag, or its file.
    :param topics: names of the topics wanted; None: all.
    :param types: likewise, of message types such as rocket_msgs/msg/World.
    :raises ValueError: when it is not a bag, or is damaged.
    """
    for file in files_of(path):
        decoders: dict[int, Decoder] = {}
        try:
            with file.open('rb') as stream:
                for schema, channel, message in mcap_file.messages(stream, topics):
                    if schema is None or (types is not None and schema.name not in types):
                        continue
                    try:
                        if schema.id not in decoders:
                            decoders[schema.id] = Decoder(schema.name, schema.data.decode('utf-8'))
                        content = decoders[schema.id].decode(message.data)
                    except ValueError as error:
                        raise ValueError(f'{channel.topic}: {error}') from error
                    yield Recorded(
                        channel.topic, schema.name, message.log_time, message.publish_time,
                        content)
        except DAMAGED as error:
            raise ValueError(f'{file}: damaged, or not an MCAP file ({error!r:.200})') from error


class UnknownFields(ValueError):
    """A message has the name of one of our types, and other fields."""


@contextmanager
def known_fields(one: Recorded) -> Iterator[None]:
    """Refuse a message whose type has the name of ours, and other fields, as it is used.

    :raises UnknownFields: naming its topic and the field.
    """
    try:
        yield
    except (AttributeError, TypeError) as error:
        what = (f'without field {error.name!r}' if isinstance(error, AttributeError)
                and error.obj is one.message else f'with fields of other types ({error})')
        raise UnknownFields(
            f'{one.topic}: got a {one.type_name} {what}, expected the fields of that message'
        ) from error


def read(
    path: Path | str, topic: str | None = None, rows: Sequence[int] | None = None,
) -> list[Trajectory]:
    """Return the flights of a bag, in the order in which they ended.

    Flights that had not ended come last, with an empty `outcome`. Flights with missing steps are
    left out.

    :param path: folder of the bag, or its file.
    :param topic: of the states, such as /sim_0/state; None: the only one that there is.
    :param rows: of the rockets wanted; None: all.
    :raises ValueError: when it is not a bag, is damaged, or needs a `topic`.

    >>> for flight in read('my_bag'):
    ...     print(flight.row, flight.episode, flight.outcome, flight.position[-1])
    """
    flights: list[Trajectory] = []
    unfinished: list[Trajectory] = []
    buffers: dict[int, TrajectoryBuffer] = {}
    outcomes: dict[str, tuple[str, ...]] = {}
    session, found = None, topic
    for one in messages(path, types=(WORLD, STATE)):
        space = one.topic.rpartition('/')[0]
        if one.type_name == WORLD:
            with known_fields(one):
                outcomes[space] = tuple(one.message.outcomes)
            continue
        if topic is None and found not in (None, one.topic):
            raise ValueError(f'topic: there are {found} and {one.topic}, expected one of them')
        if topic not in (None, one.topic):
            continue
        found = one.topic
        with known_fields(one):
            samples, begun = samples_of(one.message), one.message.session
        if begun != session:
            session = begun
            unfinished += _finished(buffers)
            buffers = {}
        names = outcomes.get(space, ())
        for row in np.unique(samples.row).tolist():
            if rows is None or row in rows:
                buffer = buffers.setdefault(row, TrajectoryBuffer())
                flights += _flights(row, buffer, samples.take(samples.row == row), names)
    return flights + unfinished + _finished(buffers)


def _finished(buffers: Mapping[int, TrajectoryBuffer]) -> list[Trajectory]:
    """Return flights that have not ended, by rocket."""
    return [buffer.finish(row, '') for row, buffer in buffers.items() if len(buffer) > 1]


def _flights(
    row: int, buffer: TrajectoryBuffer, samples: Samples, names: Sequence[str],
) -> Iterator[Trajectory]:
    """Add samples of one rocket; yield the flights that end in them."""
    start = 0
    for end in (np.flatnonzero(samples.outcome != NO_OUTCOME) + 1).tolist():
        outcome = int(samples.outcome[end - 1])
        if buffer.extend(samples.take(slice(start, end))):
            yield buffer.finish(
                row, names[outcome] if outcome < len(names) else f'outcome {outcome}')
        start = end
    if start < len(samples.step):
        buffer.extend(samples.take(slice(start, None)))
