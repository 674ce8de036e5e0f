# SPDX-License-Identifier: Apache-2.0
"""Files that Rerun writes: how writing one ends, and whether it was written to its end."""
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
"""s to write what waits to be written"""


def opened(path: Path | str) -> RrdReader:
    """Open a recording, one without a table of contents, too.

    :raises RuntimeError: or ValueError, when it is none.
    """
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', RerunWarning)
        return RrdReader(path)


def has_contents(path: Path) -> bool:
    """Return whether a recording was written to its end, where its table of contents is."""
    with warnings.catch_warnings():
        # Without one it is read all the same, and warned of.
        warnings.simplefilter('error', RerunWarning)
        try:
            RrdReader(path)
        except (RuntimeError, ValueError, RerunWarning):
            return False
    return True


def flush(stream: rr.RecordingStream) -> None:
    """Wait until all is written that was logged.

    :raises RuntimeError: when it could not be.
    """
    stream.flush(timeout_sec=PATIENCE)


def end(stream: rr.RecordingStream) -> None:
    """Write what is still to be written, and let go of the file.

    The thread that writes for Rerun ends at its first error. What waits for it then, a flush or
    the end of the stream, fails or blocks for ever. The table of contents comes last, and an
    error there is not reported: ask `has_contents`.

    :raises RuntimeError: when something could not be written.
    """
    errors: list[Exception] = []

    def run() -> None:
        try:
            flush(stream)
            stream.disconnect()
        except Exception as error:  # noqa: BLE001 - it is raised below
            errors.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(PATIENCE + 1.0)
    if thread.is_alive() or errors:
        _leave(stream)
        raise RuntimeError(f'not all could be written: {errors[0]}' if errors
                           else f'no end after {PATIENCE:g} s')


def _leave(stream: rr.RecordingStream) -> None:
    """Abandon a stream whose writer has died.

    To flush or free it may block for ever, now and when the process ends: nobody shall do it.
    """
    rr.unregister_shutdown()
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(stream))


@contextmanager
def written(stream: rr.RecordingStream, path: Path) -> Iterator[None]:
    """End a stream that writes a file with a table of contents.

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
