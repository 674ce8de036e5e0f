# SPDX-License-Identifier: Apache-2.0
"""Time-outs while waiting for a peer; time of suspension does not count."""
from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from rocket_sim_node.wire.node import waiting
from rocket_sim_node.wire.node.waiting import Silence
from rocket_sim_node.wire.node.waiting import WireTimeout


class Node:
    """The methods of a node that `Silence` calls."""

    def __init__(self) -> None:
        self.warned: list[str] = []

    def get_logger(self) -> Any:
        return SimpleNamespace(warning=self.warned.append)

    def count_publishers(self, topic: str) -> int:
        return 1


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The clock of `waiting`: a list with the time as its only entry."""
    now = [1000.0]
    monkeypatch.setattr(waiting.time, 'monotonic', lambda: now[0])
    return now


def wait(silence: Silence, clock: list[float], seconds: float) -> None:
    for _ in range(round(seconds)):
        clock[0] += 1.0
        silence.check(clock[0])


def test_a_silence_is_logged_and_ends_in_a_timeout(clock: list[float]) -> None:
    node = Node()
    silence = Silence(node, 'an answer', 20.0, '/world')  # type: ignore[arg-type]
    wait(silence, clock, 19.0)
    assert [text.split(' for')[0] for text in node.warned] == [
        'waited 5 s', 'waited 10 s', 'waited 15 s']
    with pytest.raises(WireTimeout, match='waited 20 s for an answer'):
        wait(silence, clock, 1.0)


def test_the_timeout_names_the_discovery_variables(
        clock: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_DISCOVERY_SERVER', '127.0.0.1:11811\x1b[2J')
    monkeypatch.delenv('ROS_STATIC_PEERS', raising=False)
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    silence = Silence(Node(), 'an answer', 3.0, '/world')  # type: ignore[arg-type]
    with pytest.raises(
            WireTimeout, match=r'ROS_DISCOVERY_SERVER=127\.0\.0\.1:11811 \[2J, '
            r'ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, which also decides') as ended:
        wait(silence, clock, 3.0)
    assert 'ROS_STATIC_PEERS' not in str(ended.value)


@pytest.mark.parametrize('frozen', [3600.0, 8.5, 7.5])
def test_time_in_suspension_does_not_count_as_silence(
        clock: list[float], frozen: float) -> None:
    """Agent and simulator are suspended together; the first to resume must not give up."""
    silence = Silence(Node(), 'an answer', 20.0, '/world')  # type: ignore[arg-type]
    wait(silence, clock, 12.0)
    planned = clock[0] + 1.0
    clock[0] += frozen
    silence.check(planned)
    assert silence.left == pytest.approx(5.0)
    with pytest.raises(WireTimeout):
        wait(silence, clock, 6.0)


def test_rare_checks_still_end_in_a_timeout(clock: list[float]) -> None:
    silence = Silence(Node(), 'an answer', 20.0, '/world')  # type: ignore[arg-type]
    with pytest.raises(WireTimeout):
        for _ in range(3):
            clock[0] += 10.0
            silence.check(clock[0])
