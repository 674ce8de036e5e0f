# SPDX-License-Identifier: Apache-2.0
"""A verb of a command: its action and its arguments."""
from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import field
from typing import Any

from ros2.errors import unknown


@dataclass(frozen=True)
class Verb:
    """One verb."""

    help: str
    main: Callable[[argparse.Namespace], int | None]
    """function that runs the verb and returns the exit status; None means 0"""
    arguments: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Keyword arguments of add_argument(), by the names of the argument, separated by spaces."""

    def parse(self, prog: str, argv: list[str]) -> argparse.Namespace:
        """Return the parsed arguments; an invalid one ends the program with status 2."""
        parser = argparse.ArgumentParser(prog=prog, description=self.help)
        for names, options in self.arguments.items():
            parser.add_argument(*names.split(), **options)
        args, rest = parser.parse_known_args(argv)
        if rest:
            known = ['-h', '--help', *(' '.join(self.arguments)).split()]
            parser.exit(2, f'{prog}: error: ' + unknown(f"argument '{rest[0]}'", known) + '\n')
        return args
