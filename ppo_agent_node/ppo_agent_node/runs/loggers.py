# SPDX-License-Identifier: Apache-2.0
"""Loggers beside `train.jsonl`: TensorBoard, and classes of the user's own.

A logger is a class that is called with the folder of the run, and has three methods:

- `begin(lines)` is called once, with all lines of the log so far: none in a new run. If the logger
  holds later lines, from a start that was killed, it must discard them: the run repeats them.
- `entry(line)` is called with each further line: a mapping of names to numbers, texts and lists,
  with `stage` and `iteration`, which together occur once.
- `close()` is called at the end of the start.
"""
from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Callable
from collections.abc import Mapping
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any
from typing import Protocol

TENSORBOARD = 'tensorboard'
Line = Mapping[str, Any]


class RunLogger(Protocol):
    """Receives the lines of a run's log."""

    def begin(self, lines: Sequence[Line]) -> None:
        """Start, or continue after these lines."""
        ...

    def entry(self, line: Line) -> None:
        """Log a line."""
        ...

    def close(self) -> None:
        """Write what is not written yet."""
        ...


MakeLogger = Callable[[Path], RunLogger]


def find(names: str) -> tuple[MakeLogger, ...]:
    """Return the loggers of a setting.

    :param names: separated by commas: `tensorboard`, `package.module:Class`, `file.py:Class`.
    :raises ValueError: when one cannot be had; the message says why.
    """
    return tuple(_find(name.strip()) for name in names.split(',') if name.strip())


def _find(name: str) -> MakeLogger:
    if name == TENSORBOARD:
        return _tensorboard()
    module, _, attribute = name.rpartition(':')
    if not module or not attribute.isidentifier():
        raise ValueError(
            f'loggers: got {name!r}, expected {TENSORBOARD}, package.module:Class or file.py:Class')
    try:
        found = getattr(_module(module), attribute)
    except (Exception, SystemExit) as error:  # noqa: BLE001  (a user's module may raise anything)
        raise ValueError(f'loggers: {name!r} cannot be imported: {error!r:.200}') from error
    missing = [method for method in ('begin', 'entry', 'close') if not hasattr(found, method)]
    if missing:
        raise ValueError(f'loggers: {name!r} has no method {", ".join(missing)}')
    made: MakeLogger = found
    return made


def _module(name: str) -> ModuleType:
    """Import a module by its name or its file."""
    if not name.endswith('.py'):
        return importlib.import_module(name)
    path = Path(name).resolve()
    known = f'hoverslam_logger_{hashlib.sha256(bytes(path)).hexdigest()[:16]}'
    if known in sys.modules:
        return sys.modules[known]
    spec = importlib.util.spec_from_file_location(known, path)
    if spec is None or spec.loader is None:
        raise ImportError(f'no file {name}')
    module = importlib.util.module_from_spec(spec)
    sys.modules[known] = module  # where dataclasses look for the names in their annotations
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[known]
        raise
    return module


def _tensorboard() -> MakeLogger:
    if importlib.util.find_spec('tensorboard') is None:
        raise ValueError(
            f"loggers: {TENSORBOARD!r} is not installed, expected: pip install tensorboard")
    from ppo_agent_node.runs.tensorboard import TensorBoardLogger

    return TensorBoardLogger
