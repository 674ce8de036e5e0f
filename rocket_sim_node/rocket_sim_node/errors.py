# SPDX-License-Identifier: Apache-2.0
"""Errors that interrupt work in an environment; imports nothing, as a node needs it first."""
from __future__ import annotations


class EnvironmentRestarted(RuntimeError):
    """The simulator is in a new session: unfinished work is lost.

    The caller puts the environment back with `restore` or `reset` and starts the unfinished work
    again.
    """


class EnvironmentClosed(RuntimeError):
    """This process was asked to stop, and its environment is closing: save and exit."""
