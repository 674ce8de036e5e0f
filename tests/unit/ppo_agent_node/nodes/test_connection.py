# SPDX-License-Identifier: Apache-2.0
"""The identity of an agent at its simulator."""
from __future__ import annotations

import os
import socket
from collections import namedtuple
from pathlib import Path

import pytest

from ppo_agent_node.nodes.flights.connection import agent_of_run

Root = namedtuple('Root', 'st_dev st_ino')


def test_a_run_is_the_same_agent_when_it_is_resumed_and_no_other_run_is(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = tmp_path / 'run'
    mine = agent_of_run(run)
    run.mkdir()
    assert agent_of_run(tmp_path / '.' / 'run') == mine
    assert 1 <= mine < 2**64
    others = [agent_of_run(tmp_path / 'other')]
    with monkeypatch.context() as patch:
        patch.setattr(socket, 'gethostname', lambda: 'elsewhere')
        others.append(agent_of_run(run))
    path, stat = run.resolve(), os.stat
    monkeypatch.setattr(Path, 'resolve', lambda self: path)
    monkeypatch.setattr(os, 'stat', lambda name: Root(1, 2) if name == '/' else stat(name))
    others.append(agent_of_run(run))  # as in another container of this host
    assert len({mine, *others}) == 4
