# SPDX-License-Identifier: Apache-2.0
"""Substitutions, $(name argument ...): their grammar and what each stands for."""
from __future__ import annotations

import ast
import string
from collections.abc import Callable

from ros2.errors import unknown
from ros2.launch.context import Context
from ros2.launch.context import LaunchError

_IDENTIFIER = frozenset(string.ascii_letters + string.digits + '_-')


class _Reader:
    """Reads one text from left to right, with values in the place of substitutions."""

    def __init__(self, text: str, context: Context) -> None:
        self.text = text
        self.context = context
        self.at = 0
        self.found = False

    def read(self, ends: str = '') -> str:
        """Return the text up to one of the characters `ends`."""
        result = ''
        while self.at < len(self.text) and self.text[self.at] not in ends:
            if self.text.startswith('$(', self.at):
                result += self._substitution()
                continue
            if self.text[self.at] == '\\' and self.at + 1 < len(self.text):
                self.at += 1
            result += self.text[self.at]
            self.at += 1
        return result

    def _substitution(self) -> str:
        """Return the value of one, from its $( to its closing bracket."""
        self.found = True
        start = self.at
        self.at += 2
        name_from = self.at
        while self.at < len(self.text) and self.text[self.at] in _IDENTIFIER:
            self.at += 1
        name = self.text[name_from:self.at]
        arguments = []
        while self.at < len(self.text) and self.text[self.at] == ' ':
            self.at += 1
            arguments.append(self._argument())
        if not name or self.at >= len(self.text) or self.text[self.at] != ')':
            raise LaunchError(
                f"'{self.text[start:]}' is not a substitution of the form $(name ...)")
        self.at += 1
        if name not in _MEANINGS:
            raise LaunchError(unknown(
                f'substitution $({name})', (f'$({known})' for known in _MEANINGS)))
        count, meaning = _MEANINGS[name]
        if len(arguments) != count:
            raise LaunchError(unknown(
                f'substitution $({name}) with {len(arguments)} arguments', [f'with {count}']))
        return meaning(self.context, *arguments)

    def _argument(self) -> str:
        """Return one argument: quoted, or up to a space or the closing bracket."""
        quote = self.text[self.at:self.at + 1]
        if quote not in ("'", '"') or not quote:
            return self.read(' )')
        self.at += 1
        value = self.read(quote)
        if self.at >= len(self.text):
            raise LaunchError(f'a quote is not closed in {self.text!r}')
        self.at += 1
        return value


def resolve(text: str, context: Context) -> tuple[str, bool]:
    """Return what a text stands for, and whether it holds a substitution.

    :raises LaunchError: when a substitution is malformed, unknown or fails.
    """
    reader = _Reader(text, context)
    return reader.read(), reader.found


def substitute(text: str, context: Context) -> str:
    """Return what a text stands for."""
    return resolve(text, context)[0]


def boolean(text: str) -> bool:
    """Return what a condition says.

    :raises LaunchError: unless it is true, false, 1 or 0, in any case.
    """
    value = text.strip().lower()
    if value in ('true', '1'):
        return True
    if value in ('false', '0'):
        return False
    raise LaunchError(f"condition '{text}' is neither true nor false (true, 1, false, 0)")


def _var(context: Context, name: str) -> str:
    if name not in context.arguments:
        raise LaunchError(f"launch configuration '{name}' does not exist")
    return context.arguments[name]


def _eval(context: Context, text: str) -> str:
    """Return the value of an expression; of Python's, those that our launch files use."""
    try:
        return _value(ast.parse(text.strip(), mode='eval').body)
    except (SyntaxError, ValueError) as error:
        raise LaunchError(f'$(eval) of {text!r} fails: {error}') from None
    except TypeError:
        raise LaunchError(unknown(f'$(eval) of {text!r}', [
            "'A' if 'B' else 'C'", "'A' if 'B' in ('C', 'D') else 'E'", 'each a text'])) from None


def _value(node: ast.expr) -> str:
    """Return the text that an expression stands for.

    :raises TypeError: when it is of another kind.
    """
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.IfExp(test=test, body=body, orelse=other):
            return _value(body if _holds(test) else other)
    raise TypeError


def _holds(node: ast.expr) -> bool:
    """Return whether a condition holds: a text that is not empty, or one that is in a tuple."""
    match node:
        case ast.Compare(left=left, ops=[ast.In()], comparators=[ast.Tuple(elts=found)]):
            return _value(left) in [_value(each) for each in found]
    return bool(_value(node))


_MEANINGS: dict[str, tuple[int, Callable[..., str]]] = {
    'dirname': (0, lambda context: str(context.file.parent)),
    'eval': (1, _eval),
    'var': (1, _var),
}
"""number of arguments and function, by name"""
