# SPDX-License-Identifier: Apache-2.0
"""Simulators on another host: training goes on over a network as it does within a machine."""
from __future__ import annotations

from pathlib import Path

from support.network.hosts import Hosts
from support.training.training_runs import agent
from support.training.training_runs import assert_same_run
from support.training.training_runs import simulator
from support.training.training_runs import train_in_process


def test_two_hosts_train_together(hosts: Hosts, tmp_path: Path) -> None:
    """One simulator beside the agent, one on the other host."""
    run = tmp_path / 'run'
    trainer = agent(hosts.on(0), run, simulators='/sim_*', num_groups=2)
    simulator(hosts.on(0), namespace='/sim_0')
    simulator(hosts.on(1), namespace='/sim_1')
    assert trainer.wait(120.0) == 0, hosts.logs()
    assert '/sim_0 has joined' in trainer.output()
    assert '/sim_1 has joined' in trainer.output()
    reference = tmp_path / 'reference'
    reference.mkdir()
    assert_same_run(run, train_in_process(reference / 'run', num_groups=2))
