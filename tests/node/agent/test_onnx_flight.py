# SPDX-License-Identifier: Apache-2.0
"""Nodes fly an ONNX file where PyTorch cannot be imported."""
from __future__ import annotations

import os
from pathlib import Path

import pytest
from support.processes import Processes

from ppo_agent_node.exporting.policy_export import export
from ppo_agent_node.pilots.search import find_policy

for name in ('onnx', 'onnxruntime', 'onnxscript'):
    pytest.importorskip(name)


class WithoutTorch(Processes):
    """Processes in which PyTorch and safetensors raise when they are imported."""

    @property
    def env(self) -> dict[str, str]:
        """Environment of the processes."""
        for name in ('torch', 'safetensors'):
            blocked = self.folder / 'blocked' / name
            blocked.mkdir(parents=True, exist_ok=True)
            (blocked / '__init__.py').write_text("raise ImportError(f'{__name__} is blocked')\n")
        found = super().env
        return {**found, 'PYTHONPATH': os.pathsep.join((
            str(self.folder / 'blocked'), found['PYTHONPATH']))}


def test_nodes_fly_an_onnx_file_without_torch(tmp_path: Path) -> None:
    policy = export(find_policy('rocket', 'rocket'), tmp_path / 'policy.onnx').path
    group = WithoutTorch(tmp_path)
    try:
        group.run_node('rocket_sim_node', 'simulator', num_envs=8, level=7)
        agent = group.run_node(
            'ppo_agent_node', 'ppo_agent', mode='infer', policy=policy, episodes=8)
        assert agent.wait(100.0) == 0, group.logs()
        assert f'flying {policy}' in agent.output()
        assert 'landed 8' in agent.output()
        evaluation = group.run_node(
            'ppo_agent_node', 'evaluate', policy=policy, episodes=8, optimum_sample=0,
            output=tmp_path / 'figures')
        assert evaluation.wait(100.0) == 0, group.logs()
        assert (tmp_path / 'figures' / 'evaluation.json').is_file()
        # A policy file needs it, and so does a training; the agent says so in one line.
        other = group.run_node(
            'ppo_agent_node', 'ppo_agent', mode='infer', policy='rocket', episodes=8)
        assert other.wait(100.0) == 2, group.logs()
        assert 'rocket.safetensors: needs PyTorch' in other.output()
        assert 'Traceback' not in other.output()
    finally:
        group.end()
