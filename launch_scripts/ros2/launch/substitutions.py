# SPDX-License-Identifier: Apache-2.0
"""Substitutions, $(name argument ...): their grammar and what each stands for."""
from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from dataclasses import dataclass

from ros2 import packages
from ros2.launch.context import Context
from ros2.launch.context import LaunchError
from ros2.launch.expressions import evaluate

_IDENTIFIER = frozenset('abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-')


@dataclass(frozen=True)
class Substitution:
    """One $(name argument ...); each argument is a list of texts and substitutions."""

    name: str
    arguments: tuple[Template, ...]


Template = tuple['str | Substitution', ...]


class _Parser:
    """A recursive-descent parser over one string."""

    def __init__(self, text: str, keep_escapes: bool = False) -> None:
        self.text = text
        self.keep_escapes = keep_escapes
        self.at = 0

    def template(self, ends: str = '') -> Template:
        """Read texts and substitutions up to one of the characters `ends`."""
        parts: list[str | Substitution] = []
        literal = ''
        while self.at < len(self.text):
            rest = self.text[self.at:]
            if rest[0] in ends:
                break
            if rest.startswith('$('):
                if literal:
                    parts.append(literal)
                literal = ''
                parts.append(self.substitution())
            elif rest[0] == '\\' and len(rest) > 1:
                literal += rest[:2] if self.keep_escapes else rest[1]
                self.at += 2
            else:
                literal += rest[0]
                self.at += 1
        if literal:
            parts.append(literal)
        return tuple(parts)

    def substitution(self) -> Substitution:
        """Read one, from its $( to its closing bracket."""
        start = self.at
        self.at += 2
        name_from = self.at
        while self.at < len(self.text) and self.text[self.at] in _IDENTIFIER:
            self.at += 1
        name = self.text[name_from:self.at]
        arguments = []
        while self.at < len(self.text) and self.text[self.at] == ' ':
            self.at += 1
            arguments.append(self.argument())
        if not name or self.at >= len(self.text) or self.text[self.at] != ')':
            raise LaunchError(
                f"'{self.text[start:]}' is not a substitution of the form $(name ...)")
        self.at += 1
        return Substitution(name, tuple(arguments))

    def argument(self) -> Template:
        """Read one argument: quoted, or up to a space or the closing bracket."""
        quote = self.text[self.at:self.at + 1]
        if quote not in ("'", '"') or not quote:
            return self.template(' )')
        self.at += 1
        value = self.template(quote)
        if self.at >= len(self.text):
            raise LaunchError(f'a quote is not closed in {self.text!r}')
        self.at += 1
        return value


def parse(text: str, keep_escapes: bool = False) -> Template:
    """Return the parts of a text; backslashes stay where a shell's rules are to follow.

    :raises LaunchError: when a substitution is malformed.
    """
    return _Parser(text, keep_escapes).template()


def perform(template: Template, context: Context) -> str:
    """Return the text that a template stands for.

    :raises LaunchError: when a substitution is unknown or fails.
    """
    return ''.join(
        part if isinstance(part, str) else _perform_one(part, context) for part in template)


def substitute(text: str, context: Context) -> str:
    """Parse and perform."""
    return perform(parse(text), context)


def _perform_one(item: Substitution, context: Context) -> str:
    if item.name not in _MEANINGS:
        raise LaunchError(
            f'substitution $({item.name}) is not supported, only '
            f'{", ".join(f"$({name})" for name in sorted(_MEANINGS))}')
    least, most, meaning = _MEANINGS[item.name]
    if not least <= len(item.arguments) <= most:
        raise LaunchError(
            f'substitution $({item.name}) takes {least} to {most} arguments, '
            f'got {len(item.arguments)}')
    return meaning(context, *(perform(argument, context) for argument in item.arguments))


def _var(context: Context, name: str, default: str | None = None) -> str:
    value = context.arguments.get(name, default)
    if value is None:
        raise LaunchError(f"launch configuration '{name}' does not exist")
    return value


def _env(context: Context, name: str, default: str | None = None) -> str:
    value = context.environment.get(name, default)
    if value is None:
        raise LaunchError(f"environment variable '{name}' does not exist")
    return value


def _find_exec(context: Context, name: str) -> str:
    path = shutil.which(name, path=context.environment.get('PATH'))
    if path is None:
        raise LaunchError(f"executable '{name}' not found on the PATH")
    return path


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


def _spell(value: bool) -> str:
    return 'true' if value else 'false'


def equal(left: str, right: str) -> bool:
    """Whether two texts are equal, as booleans or as numbers where both are."""
    pairs = {'true': True, '1': True, 'false': False, '0': False}
    a, b = left.strip().lower(), right.strip().lower()
    if a in pairs and b in pairs and not (a.isdigit() and b.isdigit()):
        return pairs[a] == pairs[b]
    try:
        return math.isclose(float(a), float(b))
    except ValueError:
        return left == right


_MEANINGS: dict[str, tuple[int, int, Callable[..., str]]] = {
    'var': (1, 2, _var),
    'env': (1, 2, _env),
    'dirname': (0, 0, lambda context: str(context.file.parent)),
    'filename': (0, 0, lambda context: str(context.file)),
    'log_dir': (0, 0, lambda context: str(context.log_dir)),
    'launch_log_dir': (0, 0, lambda context: str(context.log_dir)),
    'find-pkg-share': (1, 1, lambda context, name: str(packages.share_of(name))),
    'find-pkg-prefix': (1, 1, lambda context, name: str(packages.prefix_of(name))),
    'exec-in-pkg': (2, 2, lambda context, name, pkg: str(packages.executable(pkg, name))),
    'find-exec': (1, 1, _find_exec),
    'eval': (1, 99, lambda context, *parts: evaluate(' '.join(parts))),
    'not': (1, 1, lambda context, a: _spell(not boolean(a))),
    'and': (2, 2, lambda context, a, b: _spell(boolean(a) and boolean(b))),
    'or': (2, 2, lambda context, a, b: _spell(boolean(a) or boolean(b))),
    'all': (1, 99, lambda context, *parts: _spell(all(map(boolean, parts)))),
    'any': (1, 99, lambda context, *parts: _spell(any(map(boolean, parts)))),
    'equals': (2, 2, lambda context, a, b: _spell(equal(a, b))),
    'not-equals': (2, 2, lambda context, a, b: _spell(not equal(a, b))),
    'if': (2, 3, lambda context, test, a, b='': a if boolean(test) else b),
}
