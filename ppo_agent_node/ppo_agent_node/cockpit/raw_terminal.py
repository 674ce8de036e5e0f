# SPDX-License-Identifier: Apache-2.0
"""Terminal in raw mode, which delivers each key at once and is restored afterwards."""
from __future__ import annotations

import os
import select
import sys
import tempfile
import termios
from contextlib import suppress
from types import TracebackType

_INPUT, _OUTPUT, _ERROR = 0, 1, 2
_CHUNK = 4096
_ENTER, _LEAVE = '\x1b[?1049h\x1b[?25l\x1b[2J', '\x1b[?25h\x1b[?1049l'
"""Switch to the alternate screen without a cursor, and back."""
_FRAME = '\x1b[?2026h\x1b[H{}\x1b[J\x1b[?2026l'
"""Redraw of the whole screen, synchronised if the terminal supports it."""


class NoTerminal(ValueError):
    """Standard input or output is not a terminal."""


class RawTerminal:
    r"""Unbuffered keys without echo; output to standard error is captured meanwhile.

    Ctrl-C stays a signal. Ctrl-Z, Ctrl-\ and Ctrl-S would leave the terminal in raw mode, or block
    the flight, so they have no effect. Use as a context.
    """

    def __init__(self, ask: str = '', unask: str = '') -> None:
        """Check that there is a terminal; nothing changes yet.

        :param ask: sent to the terminal on entry, and `unask` on exit, both on the alternate
            screen.
        :raises NoTerminal: when there is none.
        """
        for number, name in ((_INPUT, 'standard input'), (_OUTPUT, 'standard output')):
            if not os.isatty(number):
                raise NoTerminal(
                    f'{name}: got no terminal, expected one; start it by itself in a terminal, '
                    'not from a launch file or a pipe')
        self._hello, self._goodbye = _ENTER + ask, unask + _LEAVE
        self._encoding = sys.stdout.encoding or 'utf-8'

    def __enter__(self) -> RawTerminal:
        """Switch the terminal to raw mode."""
        self._before = termios.tcgetattr(_INPUT)
        self._errors = tempfile.TemporaryFile()
        self._told = 0
        self._screen_errors = os.dup(_ERROR)
        try:
            os.dup2(self._errors.fileno(), _ERROR)
            now = termios.tcgetattr(_INPUT)
            now[0] &= ~(termios.IXON | termios.IXOFF)
            now[3] &= ~(termios.ICANON | termios.ECHO | termios.IEXTEN)
            # Ctrl-C must not discard keys between `select` and `read`, which would then block
            # until the next key.
            now[3] |= termios.NOFLSH
            now[6] = list(now[6])
            now[6][termios.VMIN], now[6][termios.VTIME] = 1, 0
            disabled = os.fpathconf(_INPUT, 'PC_VDISABLE')
            for key in (termios.VQUIT, termios.VSUSP):
                now[6][key] = bytes((disabled,))
            termios.tcsetattr(_INPUT, termios.TCSADRAIN, now)
            self._write(self._hello)
        except BaseException:
            self._restore()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Restore the terminal, and print the captured output."""
        self._restore()

    def _restore(self) -> None:
        # One by one, because some may fail if the terminal, or one side of it, is gone.
        with suppress(OSError, termios.error):
            termios.tcsetattr(_INPUT, termios.TCSADRAIN, self._before)
        with suppress(OSError):
            self._write(self._goodbye)
        with suppress(OSError, termios.error):
            # Discard pending keys, so that the shell does not run them.
            termios.tcflush(_INPUT, termios.TCIFLUSH)
        os.dup2(self._screen_errors, _ERROR)
        os.close(self._screen_errors)
        self._errors.seek(0)
        kept = self._errors.read()
        self._errors.close()
        if kept:
            with suppress(OSError):
                os.write(_ERROR, kept)

    def read(self, seconds: float = 0.0) -> bytes | None:
        """Return typed bytes, after waiting up to `seconds` for them; None when it hung up."""
        ready, _, _ = select.select([_INPUT], [], [], seconds)
        if not ready:
            return b''
        try:
            return os.read(_INPUT, _CHUNK) or None
        except OSError:
            return None

    def draw(self, lines: list[str]) -> None:
        """Show a screen of lines."""
        self._write(_FRAME.format('\x1b[K\r\n'.join(lines) + '\x1b[K'))

    def _write(self, text: str) -> None:
        data = text.encode(self._encoding, errors='replace')
        while data:
            data = data[os.write(_OUTPUT, data):]

    def errors(self) -> list[str]:
        """Return the lines written to standard error since the last call."""
        size = os.fstat(self._errors.fileno()).st_size
        data = os.pread(self._errors.fileno(), size - self._told, self._told)
        end = data.rfind(b'\n') + 1
        self._told += end
        return data[:end].decode(errors='replace').splitlines()
