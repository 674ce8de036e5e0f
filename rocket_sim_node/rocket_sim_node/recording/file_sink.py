# SPDX-License-Identifier: Apache-2.0
"""A recording as a file: written under another name, whole when it gets its own."""
from __future__ import annotations

import fcntl
import itertools
import os
import shutil
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from rocket_sim_node.recording import viewer
from rocket_sim_node.recording.blueprint import blueprint
from rocket_sim_node.recording.rewrite import add_contents
from rocket_sim_node.recording.rewrite import rewrite
from rocket_sim_node.recording.sink import APPLICATION
from rocket_sim_node.recording.sink import Look
from rocket_sim_node.recording.sink import Note
from rocket_sim_node.recording.sink import Put
from rocket_sim_node.recording.stream_file import end

RESERVE = 32 * 2**20
"""bytes of disk left free; below it the recording ends, whole"""
JOINED = 32 * 2**20
"""bytes of a file whose chunks are joined at its end, all in memory; a larger one is copied, at
100 MB a second"""


def partial_path(path: Path) -> Path:
    """Return the name under which a recording is written."""
    return path.with_name(f'{path.stem}.partial{path.suffix}')


def publish(source: Path, path: Path) -> Path:
    """Give a file its own name, or the next free one: run.rrd, run-2.rrd and so on.

    :return: the name it got.
    """
    for number in itertools.count(1):
        target = path if number == 1 else path.with_name(f'{path.stem}-{number}{path.suffix}')
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

    The file appears under its name when the sink is closed; until then it is
    `<name>.partial.rrd`. A partial file of a recorder that was killed is repaired first and
    published. An existing file is never overwritten.
    """

    live = False

    def __init__(self, path: Path, note: Note) -> None:
        """Open the partial file.

        :raises OSError: when the place cannot be written or another recorder is writing there.
        """
        self._path = path
        self._note = note
        self._partial = partial_path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._lock = os.open(self._partial, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(self._lock)
            raise OSError(
                error.errno, 'another recorder writes this file', str(self._partial)) from error
        self._check_space()
        self._whole = self._path.with_name(f'{self._path.stem}.whole{self._path.suffix}')
        self._whole.unlink(missing_ok=True)
        if os.fstat(self._lock).st_size:
            self._repair()
        self._empty = True
        self._look = Look()
        self._stream: rr.RecordingStream | None = rr.RecordingStream(APPLICATION)
        self._stream.set_log_time_enabled(False)
        # Rerun would keep the table of contents in memory until the end, 3 MB for an hour of
        # training.
        self._stream.save(self._partial, default_blueprint=blueprint(), write_footer=False)

    def _repair(self) -> None:
        """Save what a recorder that was killed left behind."""
        merged = self._path.with_name(f'{self._path.stem}.merged{self._path.suffix}')
        repaired = self._path.with_name(f'{self._path.stem}.repaired{self._path.suffix}')
        try:
            viewer.repair(self._partial, merged)
            if merged.stat().st_size > JOINED:
                merged.replace(repaired)
            else:
                rewrite(merged, repaired)
        except (viewer.ViewerError, OSError) as error:
            repaired.unlink(missing_ok=True)
            kept = publish(self._copy(), self._path.with_suffix('.damaged'))
            self._note('WARN', f'a recorder was killed and its file cannot be repaired, kept as '
                               f'{kept}: {error}')
            return
        finally:
            merged.unlink(missing_ok=True)
        where = publish(repaired, self._path)
        self._note('WARN', f'a recorder was killed: its recording is repaired, {where}')

    def _copy(self) -> Path:
        copy = self._partial.with_suffix('.copy')
        shutil.copyfile(self._partial, copy)
        return copy

    def _check_space(self, needed: int = RESERVE) -> None:
        free = shutil.disk_usage(self._path.parent).free
        if free < needed:
            raise OSError(
                28, f'only {free / 2**20:.0f} MiB of disk left, {needed / 2**20:.0f} MiB needed',
                str(self._path.parent))

    def begin(self, head: Put, look: Look) -> None:
        """Write what stands at the head of a recording, and how it is laid out."""
        if self._stream is not None and look != self._look:
            self._look = look
            self._stream.send_blueprint(_layout(look))
        self.write(head)

    def flight(self, put: Put) -> bool:
        """Write a flight that has ended; return whether it was written."""
        self.write(put)
        return self._stream is not None

    def under_way(self, put: Put, until: int) -> None:
        """Do nothing: a flight is written as a whole."""

    def write(self, put: Put) -> None:
        """Write now; when the disk is nearly full, close the file instead."""
        if self._stream is None:
            return
        try:
            self._check_space()
        except OSError as error:
            self._note('ERROR', f'the recording ends here: {error}')
            self.close()
            return
        self._empty = False
        put(self._stream)

    def _with_contents(self) -> Path:
        """Return a copy of the partial file that has a table of contents, or itself.

        Its chunks are joined when that is quick.
        """
        try:
            size = self._partial.stat().st_size
            self._check_space(size + RESERVE // 2)  # others write there, too
            if size > JOINED:
                add_contents(self._partial, self._whole, _layout(self._look))
            else:
                rewrite(self._partial, self._whole)
        except OSError as error:
            self._whole.unlink(missing_ok=True)
            self._note('WARN', 'the recording is whole but stays without a table of contents, '
                               f'which viewers miss when it is large: {error}')
            return self._partial
        return self._whole

    def close(self) -> None:
        """Finish the file and give it its name, unless the disk was too full for that."""
        if self._stream is None:
            return
        stream, self._stream = self._stream, None
        try:
            self._finish(stream)
        finally:
            os.close(self._lock)

    def _finish(self, stream: rr.RecordingStream) -> None:
        try:
            end(stream, 10.0)
        except RuntimeError as error:
            self._note('ERROR', f'the recording could not be finished and stays {self._partial}; '
                                f'the next recorder with this output repairs it: {error}')
            return
        if not self._partial.is_file():
            self._note('ERROR', f'the recording is lost: {self._partial} was removed')
            return
        if self._empty:
            self._partial.unlink()
            self._note('WARN', f'nothing was heard, nothing is recorded: no {self._path}')
            return
        where = publish(self._with_contents(), self._path)
        self._partial.unlink(missing_ok=True)
        self._note('INFO', f'recording saved: {where} ({where.stat().st_size / 2**20:.1f} MiB)')


def _layout(look: Look) -> rrb.Blueprint:
    return blueprint(training=look.training, world=look.world)
