# SPDX-License-Identifier: Apache-2.0
"""Node `watch`: what it shows beside the reports."""
from __future__ import annotations

from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest
from rcl_interfaces.msg import Log

from ppo_agent_node.nodes import watch


@pytest.mark.parametrize(('name', 'shown'), [
    ('a.simulator', ['warning, simulator: slow']),
    ('a.simulator_2.simulator', ['warning, simulator_2.simulator: slow']),
    ('a.other.simulator', []), ('b.simulator', [])])
def test_warnings_of_both_simulators_are_shown(
        monkeypatch: pytest.MonkeyPatch, name: str, shown: list[str]) -> None:
    terminal, node, heard = MagicMock(live=True), MagicMock(), {}
    terminal.__enter__.return_value = terminal
    node.get_namespace.return_value = '/a'
    node.create_subscription.side_effect = (
        lambda kind, topic, callback, qos: heard.update({topic: callback}))
    monkeypatch.setattr(watch, 'Parameters', MagicMock())
    monkeypatch.setattr(watch, 'Terminal', lambda: terminal)
    monkeypatch.setattr(watch.stopping, 'requested', lambda: True)
    watch.watch(node, MagicMock())
    heard['/rosout'](SimpleNamespace(name=name, msg='slow', level=Log.WARN))
    assert [call.args[0] for call in terminal.say.call_args_list] == shown
