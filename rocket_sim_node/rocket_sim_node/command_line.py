# SPDX-License-Identifier: Apache-2.0
"""Argument parsing of plain commands, with the NAME:=VALUE syntax of launch files."""
from __future__ import annotations

import difflib
import shutil
import signal
import sys
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import NoReturn
from typing import TypeVar

from rocket_sim_node import settings
from rocket_sim_node.printable import printable
from rocket_sim_node.printable import shell_command

S = TypeVar('S')


def parse(cls: type[S], arguments: Sequence[str]) -> S:
    """Return settings from `NAME:=VALUE …` arguments; the rest have their defaults.

    :param cls: a settings dataclass; see `rocket_sim_node.settings`.
    :raises ValueError: for an unknown name, one that is given twice, a value out of range or an
        argument without `:=`.
    :raises TypeError: for a value of the wrong type.
    """
    kinds = {info.name: info.default for info in settings.describe(cls)}
    values: dict[str, object] = {}
    for argument in arguments:
        name, found, text = argument.partition(':=')
        if not found:
            raise ValueError(f'got {argument!r}, expected NAME:=VALUE')
        close = difflib.get_close_matches(name, kinds, 1)
        if name not in kinds and close:
            raise ValueError(f'unknown argument {name!r}, did you mean {close[0]!r}?')
        if name in values:
            raise ValueError(f'{name}: given twice')
        values[name] = read_value(text, kinds.get(name))
    return settings.build(cls, values)


def read_value(text: str, like: object) -> object:
    """Return a text converted to the type of `like`, or unchanged if that fails.

    A list is written `[64,64]`, or without its brackets.
    """
    if isinstance(like, bool):
        return {'true': True, 'false': False}.get(text.lower(), text)
    if isinstance(like, int | float):
        for kind in (int, float):
            try:
                return kind(text)
            except ValueError:
                continue
    if isinstance(like, tuple):
        items = text.removeprefix('[').removesuffix(']').split(',')
        return tuple(read_value(item.strip(), 0) for item in items if item.strip())
    return text


def usage(name: str, synopsis: str, what: str, cls: type) -> str:
    """Return the usage text of a command.

    :param synopsis: its arguments in short.
    :param what: what it does, a sentence or two.
    """
    lines = [f'Usage: {name} {synopsis}', '', what, '', 'Arguments:']
    lines += [
        f'  {info.name:<12} {info.description}'
        + (f' [{info.default}]' if info.default != '' else '')
        for info in settings.describe(cls)]
    return '\n'.join(lines) + '\n'


def tell_usage(text: str, arguments: Sequence[str], bare: bool = False) -> bool:
    """Print the usage where it is asked for; return whether the command goes on.

    Without arguments the process ends with the usage as its error, and status 2.

    :param bare: whether the command runs without arguments.
    """
    if {'-h', '--help'} & set(arguments):
        sys.stdout.write(text)
        return False
    if not (arguments or bare):
        sys.stderr.write(text)
        sys.exit(2)
    return True


def watch_with(recording: Path) -> str:
    """Return the command that shows a recording, quoted for a shell."""
    return shell_command([shutil.which('rerun') or 'rerun', recording])


def fail(name: str, error: Exception) -> NoReturn:
    """End a command with its error, which may name files of strangers, and status 2."""
    sys.stderr.write(f'{name}: {printable(str(error))}\n')
    sys.exit(2)


@contextmanager
def interruptible() -> Iterator[None]:
    """Let Ctrl-C, SIGTERM and SIGHUP end a command alike: with clean-up and without output.

    The status is 130 after Ctrl-C and 143 after the others.
    """
    came = 0

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal came
        came = came or (130 if number == signal.SIGINT else 143)
        signal.default_int_handler(number, frame)

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, interrupt)
    try:
        yield
    except KeyboardInterrupt:
        sys.exit(came or 130)
    except Exception:
        # A library in C++ that was interrupted may raise an error of its own instead.
        if not came:
            raise
        sys.exit(came)


def run(
    name: str, synopsis: str, what: str, cls: type[S], do: Callable[[S], str], *,
    expected: tuple[type[Exception], ...] = (), bare: bool = False,
) -> None:
    """Run a command with this process's arguments; `do` returns the text to print at the end.

    Expected errors are reported in one line, with status 2.

    :param expected: expected errors besides ValueError, TypeError and OSError.
    :param bare: whether the command runs without arguments; if not, its usage is the error.
    """
    arguments = sys.argv[1:]
    caught: tuple[type[Exception], ...] = (ValueError, TypeError, OSError, *expected)
    if not tell_usage(usage(name, synopsis, what, cls), arguments, bare):
        return
    try:
        with interruptible():
            sys.stdout.write(printable(do(parse(cls, arguments)), '\n'))
    except caught as error:
        fail(name, error)
