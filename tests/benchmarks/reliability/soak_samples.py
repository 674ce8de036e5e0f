# SPDX-License-Identifier: Apache-2.0
"""Measurements of a soak: each node's memory, open files and threads, and steps."""
from __future__ import annotations

import csv
import json
import statistics
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from support.processes import Process

from benchmarks.training_speed.recorder import cpu_seconds
from benchmarks.training_speed.recorder import node_of

FIELDS = ('time', 'node', 'life', 'own', 'rss', 'pss', 'files', 'threads', 'cpu')
"""s since the start, name, number of the process, MiB, MiB, MiB, count, count, s"""
_MIB = 2.0**20
Row = dict[str, Any]


def own_memory(pid: int) -> float:
    """Return the anonymous memory of a process, MiB.

    Unlike PSS, it does not depend on other processes that share its libraries.
    """
    status = Path(f'/proc/{pid}/status').read_text('utf-8')
    line = next(line for line in status.splitlines() if line.startswith('RssAnon:'))
    return int(line.split()[1]) / 1024.0


def piece_of_work() -> float:
    """Return the processor time that a fixed piece of work takes, s.

    The speed of a shared machine changes from minute to minute, for all processes alike. A single
    measurement is inaccurate, because processor time may be counted in ticks of milliseconds.
    """
    began = time.process_time()
    numbers = np.linspace(-3.0, 3.0, 20_000, dtype=np.float32)
    for _ in range(20):
        names = {str(number): number for number in range(2000)}
        numbers = np.tanh(numbers)
    assert len(names) == 2000
    return time.process_time() - began


class Samples:
    """Samples of the nodes; each sample writes a few lines to a table on disk."""

    def __init__(self, path: Path) -> None:
        """Open the table."""
        self.rows: list[Row] = []
        self._file = path.open('w', newline='', encoding='utf-8')
        self._table = csv.DictWriter(self._file, FIELDS)
        self._table.writeheader()

    def take(self, seconds: float, nodes: Mapping[str, Process], lives: Mapping[str, int]) -> None:
        """Take a sample of all nodes."""
        for name, node in nodes.items():
            try:
                pid = node_of(node)
                process = psutil.Process(pid)
                memory = process.memory_full_info()
                row = {
                    'time': round(seconds, 2), 'node': name, 'life': lives[name],
                    'own': round(own_memory(pid), 3), 'rss': round(memory.rss / _MIB, 3),
                    'pss': round(memory.pss / _MIB, 3),
                    'files': process.num_fds(), 'threads': process.num_threads(),
                    'cpu': cpu_seconds(pid)}
            except (OSError, psutil.Error, IndexError, StopIteration):
                continue  # the node is just starting, or has just died
            self.rows.append(row)
            self._table.writerow(row)
        self._file.flush()

    def close(self) -> None:
        """Close the table."""
        self._file.close()


def read(path: Path) -> list[Row]:
    """Return the samples in a table that Samples wrote."""
    with path.open(newline='', encoding='utf-8') as file:
        return [{name: text if name == 'node' else float(text)
                 for name, text in line.items() if text} for line in csv.DictReader(file)]


class Iterations:
    """Speed of training, from the growing log of a run and the processor time of its nodes."""

    def __init__(self, path: Path, spell: float) -> None:
        """Start at the current end of the log.

        :param spell: duration of undisturbed training for each value, s.
        """
        self._path, self._file, self._read = path, 0, 0
        self._spell = spell
        self._cpu: float | None = None
        self._steps = self._seconds = 0.0
        self._pieces: list[float] = []
        self.rows: list[dict[str, float]] = []
        self._follow()

    def _follow(self) -> list[dict[str, Any]]:
        """Return the new lines; a resumed run replaces its log with a new, shorter file."""
        try:
            stat = self._path.stat()
        except FileNotFoundError:
            return []
        if stat.st_ino != self._file:
            self._file, self._read, self._cpu = stat.st_ino, stat.st_size, None
        if stat.st_size <= self._read:
            return []
        with self._path.open('rb') as file:
            file.seek(self._read)
            text = file.read()
        whole = text[:text.rfind(b'\n') + 1]
        self._read += len(whole)
        return [json.loads(line) for line in whole.splitlines()]

    def disturbed(self) -> None:
        """Discard the current period, because a node is disturbed."""
        self._cpu = None

    def look(self, seconds: float, nodes: Mapping[str, Process]) -> None:
        """Record the iterations that have ended since the last call.

        A new period begins after an iteration with a selection or a new level.
        """
        lines = self._follow()
        if not lines:
            return
        try:
            cpu = sum(
                cpu_seconds(node_of(node)) for name, node in nodes.items()
                if not name.startswith('recorder'))
        except OSError:
            self._cpu = None
            return
        self._pieces.append(piece_of_work())
        if self._cpu is not None:
            self._steps += sum(line['steps_per_second'] * line['seconds'] for line in lines)
            self._seconds += sum(line['seconds'] for line in lines)
        unlike = any(line.get('message') or 'selection_return' in line for line in lines)
        if self._cpu is not None and not unlike and self._seconds < self._spell:
            return
        if self._cpu is not None and not unlike and cpu > self._cpu:
            rate = self._steps / (cpu - self._cpu)
            self.rows.append({
                'time': seconds, 'steps_per_second': self._steps / self._seconds,
                'steps_per_cpu_second': rate,
                'steps_per_piece': rate * statistics.mean(self._pieces)})
        self._cpu, self._steps, self._seconds = cpu, 0.0, 0.0
        self._pieces.clear()
