# SPDX-License-Identifier: Apache-2.0
"""Rerun's files: opening, flushing and closing them, and a check for completeness."""
from __future__ import annotations

import ctypes
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun as rr
from rerun.chunk import RrdReader
from rerun.error_utils import RerunWarning

PATIENCE = 10.0
"""Time limit, s, for writing pending data."""


def opened(path: Path | str) -> RrdReader:
    """Open a recording, with or without a table of contents.

    :raises RuntimeError: or ValueError, when it is not a recording.
    """
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', RerunWarning)
        return RrdReader(path)


def has_contents(path: Path) -> bool:
    """Return whether a recording is complete, i.e. has the table of contents at its end."""
    with warnings.catch_warnings():
        # Without one it is still readable, with a warning.
        warnings.simplefilter('error', RerunWarning)
        try:
            RrdReader(path)
        except (RuntimeError, ValueError, RerunWarning):
            return False
    return True


def flush(stream: rr.RecordingStream) -> None:
    """Wait until everything that was logged is written.

    :raises RuntimeError: when that fails.
    """
    stream.flush(timeout_sec=PATIENCE)


def end(stream: rr.RecordingStream) -> None:
    """Write pending data, and close the file.

    Rerun's writer thread ends at its first error. A flush or the end of the stream then fails or
    blocks forever. The table of contents is written last, and an error there is not reported:
    check `has_contents`.

    :raises RuntimeError: when something could not be written.
    """
    errors: list[Exception] = []

    def run() -> None:
        try:
            flush(stream)
            stream.disconnect()
        except Exception as error:  # noqa: BLE001 - re-raised below
            errors.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(PATIENCE + 1.0)
    if thread.is_alive() or errors:
        _leave(stream)
        raise RuntimeError(f'not all could be written: {errors[0]}' if errors
                           else f'the file was not finished within {PATIENCE:g} s')


def _leave(stream: rr.RecordingStream) -> None:
    """Abandon a stream whose writer has died.

    Flushing or freeing it may block forever, even at exit, so it is never freed.
    """
    rr.unregister_shutdown()
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(stream))


@contextmanager
def written(stream: rr.RecordingStream, path: Path) -> Iterator[None]:
    """Close a stream to a file with a table of contents, on exit.

    :raises RuntimeError: when not all of it could be written.
    """
    try:
        yield
    except BaseException:
        _leave(stream)
        raise
    end(stream)
    if not has_contents(path):
        raise RuntimeError('its table of contents could not be written')
