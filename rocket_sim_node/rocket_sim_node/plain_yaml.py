# SPDX-License-Identifier: Apache-2.0
"""Loader of YAML files that others may have written: plain values, each name once."""
from __future__ import annotations

from typing import Any

import yaml

ERRORS = (yaml.YAMLError, ValueError, RecursionError)
"""what `load` raises for a text that is damaged or not plain"""


class _PlainLoader(yaml.SafeLoader):
    """Loader without YAML references, a few bytes of which can expand to more than all memory."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Return the next node.

        :raises yaml.YAMLError: when it is a reference.
        """
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError('refers to another value, expected plain values')
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        """Return names and values.

        :raises yaml.YAMLError: when a name is there twice, of which YAML would drop one.
        """
        found = super().construct_mapping(node, deep=deep)
        if len(found) < len(node.value):
            names = [key.value for key, _ in node.value]
            twice = next((name for name in names if names.count(name) > 1), '<<')
            raise yaml.YAMLError(f'names {twice!r} twice, expected each name once')
        return found


def load(text: str) -> Any:
    """Return the value that a YAML text describes; None for an empty one.

    :raises yaml.YAMLError: and the other `ERRORS`, when it is damaged or not plain.
    """
    # Derived from the safe loader, so it constructs plain values only.
    return yaml.load(text, _PlainLoader)
