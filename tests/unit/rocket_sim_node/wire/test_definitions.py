# SPDX-License-Identifier: Apache-2.0
"""Nodes that were built from different definitions of a message refuse each other."""
from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.type_hash import TypeHash

from rocket_sim_node.wire.messages.definitions import DefinitionsDiffer
from rocket_sim_node.wire.messages.definitions import check_definitions

OURS, THEIRS, UNTOLD = TypeHash(1, b'\x01' * 32), TypeHash(1, b'\x02' * 32), TypeHash()


def end(hash_: TypeHash | None, name: str = 'simulator', namespace: str = '/sim_0') -> Any:
    """Return one end of a topic, as rclpy describes it."""
    return SimpleNamespace(node_name=name, node_namespace=namespace, **(
        {} if hash_ is None else {'topic_type_hash': hash_}))


def node(*far: Any, own: TypeHash | None = OURS, writes: bool = False) -> Any:
    """Return the graph of an agent that reads from these ends, or writes to them."""
    near = [end(THEIRS, 'recorder'), end(own, 'agent')]
    publishers, subscriptions = (near, list(far)) if writes else (list(far), near)
    return SimpleNamespace(
        get_name=lambda: 'agent', get_namespace=lambda: '/sim_0',
        get_publishers_info_by_topic=lambda topic: publishers,
        get_subscriptions_info_by_topic=lambda topic: subscriptions)


def test_another_definition_is_refused_by_name() -> None:
    with pytest.raises(DefinitionsDiffer) as error:
        check_definitions(node(end(THEIRS)), ['observation'])
    assert str(error.value).startswith('observation: /sim_0/simulator defines')
    assert f'as {THEIRS}, expected {OURS}' in str(error.value)


def test_node_names_in_errors_are_printable() -> None:
    with pytest.raises(DefinitionsDiffer, match=r'/sim_0/si \[2Jm defines'):
        check_definitions(node(end(THEIRS, 'si\x1b[2Jm')), ['observation'])


def test_a_node_whose_name_is_not_known_yet_is_described() -> None:
    with pytest.raises(DefinitionsDiffer) as error:
        check_definitions(node(end(
            THEIRS, '_NODE_NAME_UNKNOWN_', '_NODE_NAMESPACE_UNKNOWN_')), ['observation'])
    assert str(error.value).startswith(
        'observation: a participant whose node is not known defines its messages as')


def test_a_reader_of_another_definition_is_refused() -> None:
    agent = node(end(THEIRS), writes=True)
    with pytest.raises(DefinitionsDiffer, match='action: /sim_0/simulator defines'):
        check_definitions(agent, [], ['action'])
    check_definitions(node(end(OURS), end(THEIRS, 'recorder'), writes=True), [], ['action'])


@pytest.mark.parametrize('agent', [
    node(end(OURS)), node(end(THEIRS, 'stray'), end(OURS)), node(end(UNTOLD)),
    node(end(None)), node(end(THEIRS), own=UNTOLD)])
def test_equal_and_unknown_definitions_are_accepted(agent: Any) -> None:
    assert check_definitions(agent, ['observation'])


def test_the_check_is_false_without_a_peer() -> None:
    assert not check_definitions(node(), ['observation'])
    assert not check_definitions(node(writes=True), [], ['action'])
