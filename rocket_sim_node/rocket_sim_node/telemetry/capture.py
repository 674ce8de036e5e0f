# SPDX-License-Identifier: Apache-2.0
"""Telemetry of worlds: captured at every step, decoded later, and joined to samples."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import Any
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from rocket_sim_node.telemetry.quantities import QUANTITIES
from rocket_sim_node.telemetry.samples import Samples

F64 = NDArray[np.float64]
Reader = Callable[[Any], tuple[NDArray[Any], ...]]
_EVERY = slice(None)


@dataclass(frozen=True)
class Telemetry:
    """Physical state of S rockets, world frame with y up: an attribute for each quantity.

    `quantities.QUANTITIES` defines them; `(S,)`, or `(S, k)` for those that are not scalars.
    """

    arrays: Mapping[str, NDArray[Any]]

    def __getattr__(self, name: str) -> NDArray[Any]:
        """Return a quantity by its name."""
        try:
            return self.__dict__['arrays'][name]  # type: ignore[no-any-return]
        except KeyError:
            raise AttributeError(name) from None

    def take(self, index: NDArray[Any] | slice) -> Telemetry:
        """Return the selected samples."""
        return Telemetry({name: values[index] for name, values in self.arrays.items()})


class StateCapture:
    """Base of worlds of N rockets: captures their state by the table of quantities.

    A capture is an array `(K, S)`; its rows are the quantities whose source the world has, and
    those of `captured`, from which :meth:`_derived` computes others.
    """

    captured: ClassVar[Mapping[str, str]] = {}
    """More attributes, `(N,)` or `(k, N)`, with dots, by name."""
    _finished: F64

    @cached_property
    def _layout(self) -> tuple[Reader, Reader, dict[str, int | slice]]:
        """Return readers of all attributes `(N,)` and `(k, N)`, and the rows of a capture by name.

        One reader for many attributes is the fastest way.
        """
        sources = {
            quantity.name: quantity.source for quantity in QUANTITIES
            if quantity.source and hasattr(self, quantity.source.partition('.')[0])}
        arrays = {
            name: (source, attrgetter(source)(self))
            for name, source in {**sources, **self.captured}.items()}
        flat = [name for name, (_, array) in arrays.items() if array.ndim == 1]
        deep = [name for name in arrays if name not in flat]
        places: dict[str, int | slice] = {name: row for row, name in enumerate(flat)}
        end = len(flat)
        for name in deep:
            first, end = end, end + len(arrays[name][1])
            places[name] = slice(first, end)
        flat_reader, deep_reader = (
            attrgetter(*(arrays[name][0] for name in names if len(arrays[name][1])))
            for names in (flat, deep))
        return flat_reader, deep_reader, places

    def capture(self, rows: NDArray[np.integer] | slice) -> F64:
        """Return the physical state of the selected rockets, `(K, S)`; see `telemetry_of`."""
        flat, deep, _ = self._layout
        of_flat, of_deep = (None, rows), (_EVERY, rows)
        return np.concatenate(
            [array[of_flat] for array in flat(self)] + [array[of_deep] for array in deep(self)])

    def telemetry_of(self, captured: F64) -> Telemetry:
        """Return the telemetry that a capture `(K, S)` holds."""
        known = {name: captured[place] for name, place in self._layout[2].items()}
        known |= self._derived(known)
        count = captured.shape[1]
        for quantity in QUANTITIES:
            if quantity.name not in known:  # this world does not model it
                width = quantity.width if isinstance(quantity.width, int) else 0
                known[quantity.name] = np.zeros(count if width == 1 else (width, count))
        return Telemetry({
            quantity.name: known[quantity.name].T.astype(quantity.dtype, copy=False)
            for quantity in QUANTITIES})

    def _derived(self, known: Mapping[str, F64]) -> dict[str, NDArray[Any]]:
        """Return further quantities, `(S,)` or `(k, S)`, from what was captured."""
        raise NotImplementedError

    def telemetry(self, rows: NDArray[np.integer] | slice) -> Telemetry:
        """Return the physical state of the selected rockets, S of them."""
        return self.telemetry_of(self.capture(rows))

    def _capture_ends(self, rows: NDArray[np.integer], outcome: NDArray[Any]) -> None:
        """Keep the final states of rockets whose episodes ended with an outcome."""
        self._finished = self.capture(rows)
        self._finished[self._layout[2]['outcome']] = outcome

    @property
    def captured_ends(self) -> F64:
        """Final states of the rockets that finished at the last step, `(K, S)`."""
        return self._finished

    @property
    def finished(self) -> Telemetry:
        """Final states of the rockets that finished at the last step."""
        return self.telemetry_of(self._finished)


def joined(parts: Sequence[tuple[int, Telemetry]]) -> Samples:
    """Return telemetry of several steps as samples, in the same order.

    :param parts: steps and the states at each; at least one.
    """
    return Samples.build(
        np.concatenate([np.full(len(part.row), step) for step, part in parts]),
        **{quantity.name: quantity.to_ros(
            np.concatenate([part.arrays[quantity.name] for _, part in parts]))
           for quantity in QUANTITIES})
