# SPDX-License-Identifier: Apache-2.0
"""What breaks off work in an environment. Imports nothing: a node knows it before all else."""
from __future__ import annotations


class EnvironmentRestarted(RuntimeError):
    """The simulator came back with a new session: what was not finished is lost.

    Whoever catches it puts the environment back with `restore` or `reset` and begins the
    unfinished piece of work again.
    """


class EnvironmentClosed(RuntimeError):
    """The environment is being shut down by whoever started this process: save and end."""
