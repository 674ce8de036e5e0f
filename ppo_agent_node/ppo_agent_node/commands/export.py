# SPDX-License-Identifier: Apache-2.0
"""Command `export`: writes a policy as an ONNX file, compared with PyTorch before."""
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ppo_agent_node.pilots.onnx_file import SUFFIX
from ppo_agent_node.pilots.search import find_policy
from rocket_sim_node import command_line
from rocket_sim_node import worlds
from rocket_sim_node.settings import setting


@dataclass(frozen=True)
class Export:
    """Arguments of the command."""

    policy: str = setting(
        '', '', 'policy file, or name of a shipped policy; empty: the policy of the newest '
        'finished run, or the shipped one')
    output: str = setting('', '', f'the ONNX file, {SUFFIX}')
    world: str = setting(
        'rocket', '', 'world whose newest policy is exported if none is named',
        choices=worlds.names())


def make(wanted: Export) -> str:
    """Write the file; return the text to print.

    :raises OSError: when there is no such policy, or the file cannot be written.
    :raises ValueError: when an argument does not fit, or the check fails.
    """
    output = Path(wanted.output)
    if output.suffix != SUFFIX:
        raise ValueError(f'output: got {wanted.output!r}, expected a name that ends with {SUFFIX}')
    if output.exists():
        raise ValueError(f'output: {output} already exists')
    if not output.parent.is_dir():
        raise ValueError(f'output: got {wanted.output!r}, expected a file in a folder that exists')
    policy = find_policy(wanted.policy, wanted.world)
    if policy.suffix == SUFFIX:
        raise ValueError(f'policy: {policy} is an ONNX file already')
    # Imported here: it takes seconds, and bad arguments shall be told at once.
    from ppo_agent_node.exporting.policy_export import export

    done = export(policy, output)
    return (
        f'{policy}: largest difference from PyTorch over {done.observations} observations: '
        f'{done.difference:.2g} (rounding of PyTorch itself: {done.rounding:.2g})\n'
        f'ONNX file: {done.path} ({done.size / 1024:.0f} KiB); '
        f'fly it with: ./launch_scripts/land policy:={done.path}\n')


def main() -> None:
    """Run the command."""
    command_line.run(
        'export', 'policy:=NAME_OR_FILE output:=FILE.onnx',
        'Writes a policy as an ONNX file: features, normaliser and network in one graph, and a\n'
        'description in its metadata. Its actions are first compared with those of PyTorch.',
        Export, make)


if __name__ == '__main__':
    main()
