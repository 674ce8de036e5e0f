# SPDX-License-Identifier: Apache-2.0
"""Topics of `ros_bridge`: a message is built only if someone would receive it."""
from __future__ import annotations

import pytest

from rocket_sim_node.nodes.bridge.topics import Outlet
from rocket_sim_node.nodes.bridge.topics import Topic


@pytest.mark.parametrize(('wanted', 'latched', 'expected'), [
    ((False,), False, ([],)),
    ((True,), False, (['a 1'],)),
    ((False,), True, (['a 1'],)),
    ((False, False), False, ([], [])),
    ((False, True), False, ([], ['a 1'])),
    ((True, False), False, (['a 1'], [])),
    ((False, False), True, (['a 1'], ['a 1'])),
])
def test_messages_go_where_they_are_wanted(
    wanted: tuple[bool, ...], latched: bool, expected: tuple[list[str], ...],
) -> None:
    sent: tuple[list[str], ...] = tuple([] for _ in wanted)
    built = []

    def build(name: str, number: int) -> str:
        built.append(name)
        return f'{name} {number}'

    Topic(tuple(
        Outlet(messages.append, lambda one=one: one)
        for messages, one in zip(sent, wanted, strict=True)), latched).publish(build, 'a', 1)
    assert sent == expected
    assert len(built) == any(expected)
