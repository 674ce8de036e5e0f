# SPDX-License-Identifier: Apache-2.0
"""The one kind of error that ends a command with a message instead of a traceback."""
from __future__ import annotations


class CommandError(Exception):
    """What is wrong, for the person at the terminal."""
