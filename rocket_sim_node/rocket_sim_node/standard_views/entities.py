# SPDX-License-Identifier: Apache-2.0
"""Rockets as entities of a simulation: their names, filters and states in frame `world`."""
from __future__ import annotations

import re
import signal
from collections.abc import Iterator
from collections.abc import Sequence
from contextlib import contextmanager
from types import FrameType

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.telemetry.capture import Telemetry
from rocket_sim_node.telemetry.quantities import QUANTITIES

F64 = NDArray[np.float64]

_PREFIX = 'rocket_'
_STATE = ('position', 'orientation', 'linear_velocity', 'angular_velocity')
_CLASSES = {
    'alnum': 'A-Za-z0-9', 'alpha': 'A-Za-z', 'digit': '0-9', 'lower': 'a-z', 'upper': 'A-Z'}
"""Those of POSIX that occur in names, as Python spells them."""
_LONGEST = 0.1
"""Seconds that a filter may take: an expression can take years, and a simulator must answer."""


def name_of(row: int) -> str:
    """Return the name of the rocket in a row."""
    return f'{_PREFIX}{row}'


def row_of(name: str, count: int) -> int | None:
    """Return the row of a rocket, of `count`; None if there is none of this name."""
    digits = name.removeprefix(_PREFIX)
    if len(digits) < 10 and re.fullmatch('[0-9]+', digits):
        row = int(digits)
        if row < count and name_of(row) == name:
            return row
    return None


def rows_named(pattern: str, count: int) -> list[int]:
    """Return the rows, of `count`, whose name a POSIX extended regular expression matches.

    It must match the whole name, as in Gazebo. An empty expression matches all.

    :raises ValueError: for an expression that is not valid, or takes too long.
    """
    if not pattern:
        return list(range(count))
    try:
        with _time_limit(_LONGEST):
            matches = re.compile(re.sub(r'\[:(\w+):\]', _of_class, pattern)).fullmatch
            return [row for row in range(count) if matches(name_of(row))]
    except (re.error, OverflowError, RecursionError) as error:
        raise ValueError(
            f'filter: got {pattern!r}, expected a regular expression ({error})') from None
    except TimeoutError:
        raise ValueError(
            f'filter: got {pattern!r}, expected a regular expression that takes less than '
            f'{_LONGEST:g} s') from None


def _of_class(found: re.Match[str]) -> str:
    if found[1] not in _CLASSES:
        raise re.error(f'expected one of {", ".join(_CLASSES)}, not class {found[1]}')
    return _CLASSES[found[1]]


@contextmanager
def _time_limit(seconds: float) -> Iterator[None]:
    """Raise TimeoutError in the main thread, where regular expressions look for signals."""
    def stop(number: int, frame: FrameType | None) -> None:
        raise TimeoutError

    handler = signal.signal(signal.SIGALRM, stop)
    left = signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, *left)
        signal.signal(signal.SIGALRM, handler or signal.SIG_DFL)


def states_of(telemetry: Telemetry) -> tuple[F64, F64, F64, F64]:
    """Return the motion of S rockets in frame `world`, z up (REP 103), the numbers of `state`.

    :return: position `(S, 3)`, m; orientation `(S, 4)`, x y z w; linear velocity `(S, 3)`, m/s;
        angular velocity `(S, 3)`, rad/s.
    """
    known = {quantity.name: quantity for quantity in QUANTITIES}
    position, orientation, linear, angular = (
        known[name].to_ros(telemetry.arrays[name]) for name in _STATE)
    return position, orientation, linear, angular


def within(position: F64, centre: Sequence[float], radius: float) -> NDArray[np.bool_]:
    """Return `(S,)`, whether the origins of rockets lie in a sphere, its surface included."""
    inside: NDArray[np.bool_] = np.linalg.norm(position - np.asarray(centre), axis=1) <= radius
    return inside
