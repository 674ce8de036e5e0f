# SPDX-License-Identifier: Apache-2.0
"""The module of each part of `./launch_scripts/bench`."""
from __future__ import annotations

_FOLDERS = {
    'evaluation': ('heuristic', 'optimum', 'transfer', 'tune'),
    'learning': ('examples', 'gradients', 'seeds'),
    'networks': ('learner', 'onnx'),
    'reliability': ('soak', 'stopping'),
    'reports': ('performance',),
    'time_to_result': ('result',),
    'training_speed': ('budget', 'fleet', 'ranks', 'recorder', 'rollouts'),
    'wire': ('carriers', 'discovery', 'exchange', 'hosts', 'key_latency', 'loss'),
    'worlds': ('conditions', 'peers', 'stepping', 'threads'),
}
MODULES = {
    'digests': 'benchmarks.digests',
    'experiments': 'benchmarks.experiments.__main__',
    **{part: f'benchmarks.{folder}.{part}'
       for folder, parts in _FOLDERS.items() for part in parts},
}
"""module by part"""
