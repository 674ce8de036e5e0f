# SPDX-License-Identifier: Apache-2.0
"""Describes the machine of a benchmark: `python -m benchmarks.machine FILE` writes a file."""
from __future__ import annotations

import os
import platform
import re
import sys
from datetime import UTC
from datetime import datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from ppo_agent_node.evaluation.metrics import write_json
from ppo_agent_node.runs.source_commit import source_commit

PACKAGES = (
    'rclpy', 'numpy', 'torch', 'pymunk', 'rerun-sdk', 'gymnasium', 'envpool', 'stable-baselines3')


def version(package: str) -> str:
    """Return the version of a package, or 'missing'."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return 'missing'


def child_environment() -> dict[str, str]:
    """Return the environment in which a child process finds the same modules as this one."""
    return {**os.environ, 'PYTHONPATH': os.pathsep.join(path for path in sys.path if path)}


def commit() -> str:
    """Return the commit that is checked out, marked if files differ from it."""
    return source_commit() or 'unknown'


def describe() -> dict[str, Any]:
    """Return date, machine and versions."""
    information = Path('/proc/cpuinfo').read_text('utf-8')
    model = re.search(r'^model name\s*: (.*)$', information, re.MULTILINE)
    name = model.group(1) if model else platform.machine()
    if 'avx2' in information and 'avx512f' not in information:
        name += ' without AVX-512'  # networks and NumPy are then about half as fast
    memory = os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES')
    return {
        'date': datetime.now(UTC).strftime('%Y-%m-%d'), 'commit': commit(),
        'processor': name,
        'cores': len(os.sched_getaffinity(0)), 'memory_gib': round(memory / 2**30, 1),
        'system': f'{platform.system()} {platform.release()}',
        'versions': {'python': platform.python_version(), **{p: version(p) for p in PACKAGES}}}


if __name__ == '__main__':
    write_json(Path(sys.argv[1]), describe())
