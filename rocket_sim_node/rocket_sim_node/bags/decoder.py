# SPDX-License-Identifier: Apache-2.0
"""Decoder of serialized messages by the definition that a bag stores, without ROS.

The encoding is plain CDR (DDS-XTypes 1.3, section 7.4.1, XCDR1): numbers are aligned to their
size, counted from after the first four bytes, which name the byte order.
"""
from __future__ import annotations

import struct
from graphlib import CycleError
from graphlib import TopologicalSorter
from types import SimpleNamespace
from typing import Any

import numpy as np

from rocket_sim_node.bags.definitions import BORDER
from rocket_sim_node.bags.definitions import PRIMITIVES
from rocket_sim_node.bags.definitions import fields
from rocket_sim_node.bags.definitions import full_name

_ORDERS = {b'\x00\x01': '<', b'\x00\x00': '>'}


class Decoder:
    """Decoder of one message type."""

    def __init__(self, type_name: str, text: str) -> None:
        """Read a definition in the form of `definitions.definition`.

        :raises ValueError: when a message that is part of it is missing, or contains itself.
        """
        self._first = type_name.replace('/msg/', '/')
        first, *others = text.split(f'{BORDER}\n')
        texts = {self._first: first}
        for other in others:
            head, _, body = other.partition('\n')
            texts[head.removeprefix('MSG: ').strip().replace('/msg/', '/')] = body
        self._fields: dict[str, list[tuple[str, str, str]]] = {}
        for name, one in texts.items():
            package = name.partition('/')[0]
            self._fields[name] = [
                (kind if kind in PRIMITIVES or kind == 'string' else full_name(kind, package),
                 array, field)
                for kind, array, field in fields(one)]
        for name, found in self._fields.items():
            for kind, _, field in found:
                if kind not in PRIMITIVES and kind != 'string' and kind not in self._fields:
                    raise ValueError(f'{name}: {field} is of type {kind}, which is not defined')
        try:
            TopologicalSorter({
                name: [kind for kind, _, _ in found if kind in self._fields]
                for name, found in self._fields.items()}).prepare()
        except CycleError as error:
            part, whole = error.args[1][:2]
            field = next(field for kind, _, field in self._fields[whole] if kind == part)
            raise ValueError(
                f'{whole}: {field} is of type {part}, which contains {whole}') from error

    def decode(self, data: bytes) -> Any:
        """Return a message: an object with its fields, sequences of numbers as NumPy arrays.

        :raises ValueError: when it is cut short, or not plain CDR.
        """
        order = _ORDERS.get(bytes(data[:2]))
        if order is None:
            raise ValueError(f'begins with {bytes(data[:4]).hex()}, expected plain CDR')
        try:
            return _Reading(self._fields, data, order).message(self._first)
        except (struct.error, UnicodeDecodeError, RecursionError) as error:
            raise ValueError(f'cut short or damaged: {len(data)} bytes ({error})') from error


class _Reading:
    """One message that is being read."""

    def __init__(
        self, known: dict[str, list[tuple[str, str, str]]], data: bytes, order: str,
    ) -> None:
        self._known, self._data, self._order, self._place = known, data, order, 4

    def message(self, name: str) -> SimpleNamespace:
        return SimpleNamespace(**{
            field: self._field(kind, array) for kind, array, field in self._known[name]})

    def _field(self, kind: str, array: str) -> Any:
        if not array:
            return self._one(kind)
        size = array[1:-1]
        count = int(size) if size.isdigit() else self._number('u4')
        if kind in PRIMITIVES:
            return self._numbers(PRIMITIVES[kind], count)
        if count > len(self._data):
            raise ValueError(f'a sequence of {count} in {len(self._data)} bytes')
        return [self._one(kind) for _ in range(count)]

    def _one(self, kind: str) -> Any:
        if kind in PRIMITIVES:
            return self._number(PRIMITIVES[kind])
        if kind == 'string':
            length = self._number('u4')
            text = self._take(length)
            return text[:-1].decode('utf-8')
        return self.message(kind)

    def _align(self, size: int) -> None:
        self._place += -(self._place - 4) % size

    def _take(self, count: int) -> bytes:
        end = self._place + count
        if end > len(self._data):
            raise ValueError(f'cut short: {len(self._data)} bytes, expected {end}')
        part = bytes(self._data[self._place:end])
        self._place = end
        return part

    def _number(self, code: str) -> Any:
        return self._numbers(code, 1)[0].item()

    def _numbers(self, code: str, count: int) -> Any:
        dtype = np.dtype(self._order + code) if code != '?' else np.dtype('?')
        if count:
            self._align(dtype.itemsize)
        return np.frombuffer(self._take(count * dtype.itemsize), dtype)
