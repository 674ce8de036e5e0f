# SPDX-License-Identifier: Apache-2.0
"""Runs a part such that SIGTERM and SIGHUP end it as Ctrl-C does: with its nodes."""
from __future__ import annotations

import runpy
import sys

from benchmarks.parts import MODULES
from rocket_sim_node.command_line import interruptible


def main() -> None:
    """Run the part PART [OPTION ...]."""
    with interruptible():
        runpy.run_module(MODULES[sys.argv.pop(1)], run_name='__main__', alter_sys=True)


if __name__ == '__main__':
    main()
