# SPDX-License-Identifier: Apache-2.0
"""Sink that writes a recording to a file, under a temporary name until it is complete."""
from __future__ import annotations

import errno
import fcntl
import os
import time
from contextlib import suppress
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from rocket_sim_node import input_file
from rocket_sim_node.recording.scene.blueprint import blueprint
from rocket_sim_node.recording.sinks import rerun_program
from rocket_sim_node.recording.sinks.base import APPLICATION
from rocket_sim_node.recording.sinks.base import Look
from rocket_sim_node.recording.sinks.base import Put
from rocket_sim_node.recording.sinks.destinations import RESERVE
from rocket_sim_node.recording.sinks.destinations import Note
from rocket_sim_node.recording.sinks.destinations import check_space
from rocket_sim_node.recording.sinks.destinations import is_at
from rocket_sim_node.recording.sinks.destinations import lock_error
from rocket_sim_node.recording.sinks.destinations import numbered
from rocket_sim_node.recording.sinks.rewrite import add_contents
from rocket_sim_node.recording.sinks.rewrite import is_empty
from rocket_sim_node.recording.sinks.rewrite import rewrite
from rocket_sim_node.recording.sinks.rrd_file import PATIENCE
from rocket_sim_node.recording.sinks.rrd_file import end
from rocket_sim_node.recording.sinks.rrd_file import flush

UNHEARD = 2**18
"""Upper limit, bytes, of a file without any recorded data."""
JOINED = 32 * 2**20
"""Maximum bytes of a file whose chunks are joined in memory at its end; a larger one is copied, at
100 MB a second."""
_BEGINNING = 2**16
"""Bytes that the beginning of a recording, its layout, takes at most."""
LOOK = 10.0
"""Seconds between checks that logged data was written to the file."""


def partial_path(path: Path) -> Path:
    """Return the temporary name of a recording."""
    return path.with_name(f'{path.stem}.partial{path.suffix}')


def publish(source: Path, path: Path) -> Path:
    """Rename a file to `path`, or to the next free name: run.rrd, run-2.rrd and so on.

    :return: the resulting path.
    """
    for target in numbered(path, path.suffix):
        try:
            os.link(source, target)
        except FileExistsError:
            continue
        except OSError:  # a file system without hard links
            if target.exists():
                continue
            source.rename(target)
            return target
        source.unlink()
        return target
    raise AssertionError


class FileSink:
    """Writes a recording to a file.

    The file gets its name when the sink is closed; until then it is `<name>.partial.rrd`, locked.
    A partial file of a recorder that was killed or could not finish is repaired and published
    first. An existing file is never overwritten. A file without flights and
    without reports of a training is not kept.
    """

    live = False

    def __init__(self, path: Path, note: Note) -> None:
        """Open the partial file.

        :raises OSError: when the folder is not writable, has no space, or another recorder is
            writing there.
        """
        self._path = path
        self._note = note
        self.complete = True
        """Whether nothing was left unfinished; known once the sink is closed."""
        self.published: Path | None = None
        """The resulting file, once the sink is closed; None if there is none under its name."""
        self._partial = partial_path(path)
        self._merged, self._repaired, self._whole = (
            self._partial.with_name(f'{self._partial.stem}.{name}{path.suffix}')
            for name in ('merged', 'repaired', 'whole'))
        path.parent.mkdir(parents=True, exist_ok=True)
        self._lock = self._take()
        try:
            for left_behind in (self._merged, self._repaired, self._whole):
                left_behind.unlink(missing_ok=True)
            self._check_space()
            if os.fstat(self._lock).st_size:
                self._repair()
                repaired, self._lock = self._lock, self._take()
                os.close(repaired)
            self._empty, self._stood = True, False
            self._look = Look()
            self._next_look = time.monotonic() + LOOK
            self._stream: rr.RecordingStream | None = self._begin()
        except BaseException:
            if not os.fstat(self._lock).st_size and is_at(self._lock, self._partial):
                self._partial.unlink()
            os.close(self._lock)
            raise

    @property
    def open(self) -> bool:
        """Whether more can be written."""
        return self._stream is not None

    def _take(self) -> int:
        """Return a lock on the partial file, which is created if missing."""
        while True:
            lock = input_file.open_in_place(self._partial, os.O_RDWR | os.O_CREAT)
            try:
                _lock(lock)
            except OSError as error:
                os.close(lock)
                raise lock_error(
                    error, 'another recorder is writing this file', self._partial) from error
            if not is_at(lock, self._partial):  # it was published at this moment
                os.close(lock)
            elif os.fstat(lock).st_nlink > 1:  # published by a process killed at this moment
                self._partial.unlink()
                os.close(lock)
            else:
                return lock

    def _become(self, source: Path) -> None:
        """Replace the partial file by another one, also locked."""
        lock = os.open(source, os.O_RDWR | os.O_CLOEXEC)
        _lock(lock)
        source.replace(self._partial)
        os.close(self._lock)
        self._lock = lock

    def _begin(self) -> rr.RecordingStream:
        self._reserve_beginning()
        stream = rr.RecordingStream(APPLICATION)
        stream.set_log_time_enabled(False)
        try:
            # Otherwise Rerun would keep the table of contents in memory until the end, 3 MB for an
            # hour of training.
            stream.save(self._partial, default_blueprint=blueprint(), write_footer=False)
        except RuntimeError as error:
            raise OSError(5, f'could not be written: {error}', str(self._partial)) from error
        return stream

    def _reserve_beginning(self) -> None:
        """Check that the beginning of a recording can be written.

        A quota or a limit of the file's size shows in no figure of the disk, and `save` of Rerun
        would wait for ever for a writer that failed at once.

        :raises OSError: naming the file.
        """
        try:
            os.posix_fallocate(self._lock, 0, _BEGINNING)
        except OSError as error:
            if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS):
                raise OSError(
                    error.errno, f'could not be written: {error.strerror}', str(self._partial)
                ) from error
        finally:
            os.ftruncate(self._lock, 0)

    def _repair(self) -> None:
        """Publish the readable part of the partial file.

        :raises OSError: when there is no space, or the repair was stopped; the partial file stays.
        """
        size = os.fstat(self._lock).st_size
        self._check_space(2 * size + RESERVE)
        try:
            rerun_program.repair(self._partial, self._merged)
            if size < UNHEARD and is_empty(self._merged):
                self._partial.unlink()
                self._note('INFO', 'a recorder was killed before it received anything')
                return
            if size > JOINED:
                self._become(self._merged)
            else:
                rewrite(self._merged, self._repaired)
                self._become(self._repaired)
        except rerun_program.ViewerEnded as error:
            raise OSError(
                errno.EINTR, f'left by a recorder that was killed, not repaired yet, {error}',
                str(self._partial)) from error
        except (rerun_program.ViewerError, OSError) as error:
            self._repaired.unlink(missing_ok=True)
            self._check_space()
            kept = publish(self._partial, self._path.with_suffix('.damaged'))
            self._note('WARN', 'a recorder was killed and its file cannot be repaired; it is kept '
                               f'as {kept}: {error}')
            return
        finally:
            self._merged.unlink(missing_ok=True)
        where = publish(self._partial, self._path)
        self._note('WARN', f'a recorder was killed: its recording is repaired, {where}')

    def _check_space(self, needed: int = RESERVE) -> None:
        check_space(self._path.parent, needed)

    def begin(self, head: Put, look: Look) -> None:
        """Write the start of a recording, and its layout."""
        if self._stream is not None and look != self._look:
            self._look = look
            self._stream.send_blueprint(_layout(look))
        self._write(head)

    def write_trajectory(self, put: Put) -> bool:
        """Write an ended flight; return whether it was certainly written."""
        self.write(put)
        return self._stream is not None

    def under_way(self, put: Put, until: int) -> None:
        """Do nothing: flights are written when they have ended."""

    def write(self, put: Put) -> None:
        """Write now, or close the file when the disk is nearly full."""
        self._empty = False
        self._write(put)

    def _write(self, put: Put) -> None:
        if self._stream is None:
            return
        try:
            self._check_space()
        except OSError as error:
            self._note('ERROR', f'the recording ends here: {error}')
            self.close()
            return
        put(self._stream)
        if time.monotonic() > self._next_look:
            self._look_at(self._stream)

    def _look_at(self, stream: rr.RecordingStream) -> None:
        """Check that logged data is written, and close the file if it is not.

        A disk may block for a while, for instance a network disk; a dead writer fails at once.
        """
        began = time.monotonic()
        try:
            flush(stream)
            self._stood = False
        except RuntimeError as error:
            if time.monotonic() - began < PATIENCE:
                self.close()  # reports the reason
            elif self._stood:
                self._note('ERROR', f'the recording ends here: {error}')
                self.close()
            else:
                self._note('WARN', f'nothing has been written for {PATIENCE:g} s: {error}')
                self._stood = True
        self._next_look = time.monotonic() + LOOK

    def _add_contents(self) -> None:
        """Add a table of contents to the partial file; join its chunks when that is fast."""
        try:
            size = self._partial.stat().st_size
            self._check_space(size + RESERVE // 2)  # other processes may write there too
            if size > JOINED:
                add_contents(self._partial, self._whole, _layout(self._look))
            else:
                rewrite(self._partial, self._whole)
            self._become(self._whole)
        except OSError as error:
            with suppress(OSError):
                self._whole.unlink(missing_ok=True)
            self._note('WARN', 'the recording is complete, but has no table of contents; '
                               f'viewers need one for large files: {error}')

    def close(self) -> None:
        """Finish the file and rename it, unless the disk was too full."""
        if self._stream is None:
            return
        stream, self._stream = self._stream, None
        try:
            self.complete = self._finish(stream)
        finally:
            os.close(self._lock)

    def _finish(self, stream: rr.RecordingStream) -> bool:
        """Finish the file and rename it; return whether that was possible."""
        try:
            end(stream)
        except RuntimeError as error:
            if not self._empty:
                self._note('ERROR', f'the recording could not be finished and remains at '
                                    f'{self._partial}; the next recorder with this output '
                                    f'repairs it: {error}')
                return False
        if not is_at(self._lock, self._partial):
            self._note('ERROR', f'the recording is lost: {self._partial} was removed')
            return False
        if self._empty:
            self._partial.unlink()
            self._note('WARN', f'nothing was recorded: {self._path} was not written')
            return True
        self._add_contents()
        try:
            where = publish(self._partial, self._path)
        except OSError as error:
            self._note('ERROR', f'the recording is complete, but remains at {self._partial}: '
                                f'{error}')
            return False
        self.published = where
        self._note('INFO', f'recording saved: {where} ({where.stat().st_size / 2**20:.1f} MiB)')
        return True


def _lock(file: int) -> None:
    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _layout(look: Look) -> rrb.Blueprint:
    return blueprint(training=look.training, unusual=look.unusual, world=look.world)
