# SPDX-License-Identifier: Apache-2.0
"""Time of an ONNX file in onnxruntime and of its policy in PyTorch, by batch size, on one core.

The pilots are the ones that the nodes use, from NumPy observations to NumPy actions. All cases are
measured alternately in several rounds; medians are reported. If there is a GPU, PyTorch on it is a
third case.
"""
from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from pathlib import Path

import torch

from ppo_agent_node.evaluation.metrics import write_json
from ppo_agent_node.exporting.policy_export import export
from ppo_agent_node.exporting.policy_export import sample
from ppo_agent_node.flying.pilot import Pilot
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.pilots.search import find_policy
from rocket_sim_node import worlds
from rocket_sim_node.worlds.base import F32

_POLICIES = {
    'rocket': 'rocket', 'robust': 'rocket', 'lunar_lander': 'lunar_lander'}
"""Shipped policies and their worlds."""


def microseconds(pilot: Pilot, observation: F32, seconds: float) -> float:
    """Return the mean time of a call, us, measured for about `seconds`."""
    count, start = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - start) < seconds:
        for _ in range(4):
            pilot(observation)
        count += 4
    return 1e6 * elapsed / count


def main() -> None:
    """Print the table and write the figures."""
    parser = argparse.ArgumentParser(prog='bench onnx', description=__doc__.split('\n')[0])
    parser.add_argument('--rounds', type=int, default=7, help='number of rounds')
    parser.add_argument(
        '--seconds', type=float, default=0.2, help='duration of one measurement, s')
    parser.add_argument(
        '--sizes', type=int, nargs='+', default=[1, 16, 256, 4096], help='batch sizes')
    parser.add_argument(
        '--policies', nargs='+', choices=_POLICIES, default=list(_POLICIES),
        help='shipped policies to measure')
    parser.add_argument('--output', type=Path, help='JSON file for the figures')
    options = parser.parse_args()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    torch.set_num_threads(1)
    figures = []
    print(f'µs a call on one core, median of {options.rounds} rounds')
    gpu = torch.cuda.is_available()
    print(f'{"policy":14s}{"batch":>6}{"torch":>10}{"onnx":>10}{"torch / onnx":>14}'
          + (f'{"GPU":>10}{"torch / GPU":>14}' if gpu else ''))
    for name in options.policies:
        path = find_policy(name, _POLICIES[name])
        seen = {'observation': 'extended'} if name == 'robust' else {}
        spec = worlds.make(_POLICIES[name], 1, **seen).spec
        observation = sample(path, spec)
        with tempfile.TemporaryDirectory() as folder:
            done = export(path, Path(folder) / f'{name}.onnx')
            pilots = {'torch': PolicyPilot(path, spec), 'onnx': PolicyPilot(done.path, spec)}
        if gpu:
            pilots['GPU'] = PolicyPilot(path, spec, 'cuda')
        for size in options.sizes:
            rows = observation[:size]
            times: dict[str, list[float]] = {kind: [] for kind in pilots}
            for _ in range(options.rounds):
                for kind, pilot in pilots.items():
                    times[kind].append(microseconds(pilot, rows, options.seconds))
            found = {kind: statistics.median(values) for kind, values in times.items()}
            ratio = found['torch'] / found['onnx']
            print(f'{name:14s}{len(rows):>6}{found["torch"]:>10.1f}{found["onnx"]:>10.1f}'
                  f'{ratio:>14.2f}'
                  + (f'{found["GPU"]:>10.1f}{found["torch"] / found["GPU"]:>14.2f}'
                     if gpu else ''), flush=True)
            figures.append({
                'policy': name, 'batch': len(rows), 'microseconds': found, 'ratio': ratio,
                'greatest_difference': done.difference})
    if options.output:
        write_json(options.output, {'figures': figures})


if __name__ == '__main__':
    main()
