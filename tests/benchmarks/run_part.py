# SPDX-License-Identifier: Apache-2.0
"""Runs a part; SIGTERM and SIGHUP end it with its nodes, as Ctrl-C does."""
from __future__ import annotations

import runpy
import sys

from benchmarks.parts import MODULES
from rocket_sim_node.command_line import interruptible


def main() -> None:
    """Run the part that the first argument names, with the other arguments."""
    with interruptible():
        runpy.run_module(MODULES[sys.argv.pop(1)], run_name='__main__', alter_sys=True)


if __name__ == '__main__':
    main()
