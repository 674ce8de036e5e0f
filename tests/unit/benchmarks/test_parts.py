# SPDX-License-Identifier: Apache-2.0
"""Each part of `./launch_scripts/bench` has its module."""
from __future__ import annotations

import importlib.util
import re
from pathlib import Path

from benchmarks.parts import MODULES

SCRIPT = Path(__file__).parents[3] / 'launch_scripts' / 'bench'


def test_the_command_and_the_modules_have_the_same_parts() -> None:
    found = re.findall(r'^(?:parts|alone)=\(([^)]*)\)', SCRIPT.read_text(), re.MULTILINE)
    assert {'performance', *' '.join(found).split()} == MODULES.keys()
    assert [name for name in MODULES.values() if importlib.util.find_spec(name) is None] == []
