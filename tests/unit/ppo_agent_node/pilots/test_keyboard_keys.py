# SPDX-License-Identifier: Apache-2.0
"""Bytes of a terminal, read as keys; and which keys are down."""
from __future__ import annotations

import pytest

from ppo_agent_node.pilots.keys import HeldKeys
from ppo_agent_node.pilots.keys import KeyEvent
from ppo_agent_node.pilots.keys import KeyReader
from ppo_agent_node.pilots.keys import Motion

LEFT = KeyEvent('left')
SPACE = KeyEvent('space')


@pytest.mark.parametrize(('data', 'keys'), [
    (b'w', ['w']), (b'W', ['w']), (b' ', ['space']), (b'\r', ['enter']), (b'0x', ['0', 'x']),
    (b'\x1b[A\x1b[B\x1b[C\x1b[D', ['up', 'down', 'right', 'left']),
    (b'\x1bOA\x1bOD', ['up', 'left']),
    (b'\x1b[1;5C', ['right']),
    (b'\x1b[15~w', ['w']), (b'\x1b[200~', []), (b'\x1b[<0;3;4Mq', ['q']), (b'\x1b[?1;2cx', ['x']),
    (b'\x1bw', ['escape', 'w']), (b'\x1b\x1b[A', ['escape', 'up']),
    (b'\x1b[\x07w', ['w']),
    (b'\xc3\xa4w', ['ä', 'w']), (b'\xffw', ['w']), (b'\x00\x07w', ['w']),
    (b'\x03', ['ctrl+c']),
    (b'\x1b[99;5u', ['ctrl+c']), (b'\x1b[32u', ['space']), (b'\x1b[119;2u', ['w']),
    (b'\x1b[119:87;2u', ['w']), (b'\x1b[57441u', []), (b'\x1b[9999999999u', []),
    (b'\x1b[119;1:9u', []),
])
def test_bytes_are_keys(data: bytes, keys: list[str]) -> None:
    assert [event.key for event in KeyReader().feed(data)] == keys
    # However they are cut.
    reader = KeyReader()
    assert [e.key for k in range(len(data)) for e in reader.feed(data[k:k + 1])] == keys


def test_arrow_split_over_reads_comes_when_it_is_complete() -> None:
    reader = KeyReader()
    assert reader.feed(b'\x1b') == []
    assert reader.feed(b'[') == []
    assert reader.feed(b'Dw') == [LEFT, KeyEvent('w')]
    assert reader.feed(b'\x1b[1') == []
    assert reader.feed(b';1:3D') == [KeyEvent('left', Motion.RELEASE)]


def test_endless_sequence_is_dropped() -> None:
    reader = KeyReader()
    assert reader.feed(b'\x1b[' + b'1' * 100_000) == []
    assert len(reader._rest) < 100
    assert reader.feed(b'\x1b[A') [-1:] == [KeyEvent('up')]


def test_motions_of_the_kitty_protocol() -> None:
    reader = KeyReader()
    assert reader.feed(b'\x1b[32;1:1u\x1b[32;1:2u\x1b[32;1:3u\x1b[1;1:2D') == [
        KeyEvent('space', Motion.PRESS), KeyEvent('space', Motion.REPEAT),
        KeyEvent('space', Motion.RELEASE), KeyEvent('left', Motion.REPEAT)]
    assert not reader.exact
    assert reader.feed(b'\x1b[?11u') == []
    assert reader.exact


def hold(keys: HeldKeys, event: KeyEvent, begin: float, end: float, delay: float = 0.5) -> None:
    """Press a key as a terminal reports it: once, and after a delay 30 times a second."""
    keys.move(event, begin)
    count = int((end - begin - delay) * 30 + 1e-9)
    for k in range(count + 1 if end - begin >= delay else 0):
        keys.move(event, begin + delay + k / 30)


def test_tap_is_held_for_the_delay_of_the_keyboard() -> None:
    keys = HeldKeys(delay=0.6, gap=0.12)
    assert not keys.held('left', 0.0)
    keys.move(LEFT, 1.0)
    assert keys.held('left', 1.59)
    assert not keys.held('left', 1.61)


def test_held_key_has_no_gap_and_ends_soon_after_its_last_repeat() -> None:
    keys = HeldKeys(delay=0.6, gap=0.12)
    keys.move(LEFT, 0.0)
    for k in range(45):
        now = 0.5 + k / 30
        assert keys.held('left', now - 1e-3), now
        keys.move(LEFT, now)
    assert keys.held('left', now + 0.11)
    assert not keys.held('left', now + 0.13)


def test_key_that_breaks_into_repeats_keeps_the_other_one_down() -> None:
    keys = HeldKeys(delay=0.6, gap=0.12)
    hold(keys, SPACE, 0.0, 1.0)
    hold(keys, LEFT, 1.0, 2.0)
    assert keys.held('space', 2.0)
    assert keys.held('left', 2.0)
    assert not keys.held('space', 2.2)
    assert not keys.held('left', 2.2)


def test_key_that_was_let_go_before_stays_up() -> None:
    keys = HeldKeys(delay=0.6, gap=0.12)
    hold(keys, SPACE, 0.0, 1.0)
    keys.move(LEFT, 1.5)
    assert not keys.held('space', 1.5)
    keys.move(LEFT, 1.6)
    keys.release('left')
    assert not keys.held('left', 1.6)


def test_reported_releases_are_exact() -> None:
    keys = HeldKeys(delay=0.6, gap=0.12)
    keys.know_releases()
    keys.move(SPACE, 0.0)
    keys.move(LEFT, 0.5)
    assert keys.held('space', 100.0)
    keys.move(KeyEvent('space', Motion.RELEASE), 100.0)
    assert not keys.held('space', 100.0)
    assert keys.held('left', 100.0)
    keys.clear()
    assert not keys.held('left', 100.0)
