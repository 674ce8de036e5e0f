# SPDX-License-Identifier: Apache-2.0
"""Untrusted text reaches logs and terminals without control codes."""
from __future__ import annotations

import io
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rcl_interfaces.msg import Log
from rich.control import strip_control_codes
from rocket_msgs import srv

from ppo_agent_node.nodes.agent.rosout import _on_log
from ppo_agent_node.terminal import Terminal
from rocket_sim_node import worlds
from rocket_sim_node.printable import printable
from rocket_sim_node.recording.sinks.web_page import INVITATION
from rocket_sim_node.telemetry.training_status import Status
from rocket_sim_node.wire.client.connection import Connection
from rocket_sim_node.wire.client.connection import SimulatorBusy
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.worlds import EnvironmentRestarted
from rocket_sim_node.worlds.jobs import Command
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import Restore
from rocket_sim_node.worlds.jobs import Snapshot

SPEC = worlds.make('rocket').spec
COMMANDS = (
    '\x1b]0;title\x07', '\x1b[2J', '\x9b2J', '\x9d0;title\x9c', '\x1b', '\x9b', '\r', '\b', '\x00')
WORDS = st.lists(st.one_of(st.sampled_from(COMMANDS), st.text())).map(''.join)
"""any text, with what commands a terminal more often than by chance"""


class Screen(io.StringIO):
    """A terminal, as what is written to it."""

    def isatty(self) -> bool:
        return True


@given(WORDS)
def test_a_text_keeps_its_length_and_printable_characters(text: str) -> None:
    clean = printable(text, '\n')
    assert len(clean) == len(text)
    for before, after in zip(text, clean, strict=True):
        assert after == (before if before.isprintable() or before == '\n' else ' ')
    assert printable(text).isprintable()


def shown(kind: type[io.StringIO], text: str) -> str:
    """Return what a terminal, or a file, gets when a text comes to it each way that there is."""
    screen = kind()
    terminal = Terminal(screen)
    say = partial(_on_log, terminal.say, 'here.', '', 'second')
    terminal.say(text)
    terminal.show(Status(stage='finetune', message=text))
    say(Log(name='here.node', level=Log.ERROR, msg=text))
    say(Log(name='here.second.node', level=Log.ERROR, msg=text))
    say(Log(name='here.node', level=Log.INFO, msg=INVITATION + text))
    return screen.getvalue()


@given(WORDS)
def test_a_file_gets_printable_lines(text: str) -> None:
    assert printable(shown(io.StringIO, text), '\n\t') == shown(io.StringIO, text)


@given(text=WORDS)
def test_text_adds_no_control_codes_to_those_of_the_display(
        monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    """The display's own control codes are the same with any text of as many lines."""
    monkeypatch.setenv('TERM', 'xterm')
    text = strip_control_codes(text)  # as rich does, which makes lines empty
    plain = ''.join(sign if sign in '\n\t' else 'x' for sign in text)
    got, expected = (
        [sign for sign in shown(Screen, some) if not sign.isprintable() and sign not in '\n\t']
        for some in (text, plain))
    assert got == expected


@pytest.mark.parametrize('command', [Reset(1), Restore(b''), Snapshot()])
@given(text=WORDS, code=st.sampled_from([srv.Reset.Response.BUSY, 1, 2, 3]),
       patience=st.sampled_from([0.0, 9.0]))
def test_answers_of_a_service_are_printable(
        command: Command, text: str, code: int, patience: float) -> None:
    said = list[str]()
    connection: Any = SimpleNamespace(
        name='simulator', adopt_spec=lambda: None, _asked=0.0, _warned=False,
        _options=SimpleNamespace(patience=patience), _begin_call=lambda *_: None,
        _node=SimpleNamespace(get_logger=lambda: SimpleNamespace(warning=said.append)))
    try:
        Connection._judge(
            connection, command, SimpleNamespace(OK=0, BUSY=srv.Reset.Response.BUSY, code=code,
                                                   message=text), 1.0)
    except (ValueError, SimulatorBusy, EnvironmentRestarted) as error:
        said.append(str(error))
    assert len(said) == 1
    assert said[0].isprintable()


@pytest.mark.parametrize('field', [
    'world', 'observation_names', 'action_names', 'outcomes', 'settings'])
@given(text=WORDS)
def test_a_world_whose_names_cannot_be_printed_is_refused(field: str, text: str) -> None:
    """Names reach logs and terminals in many ways, as in the difference between two worlds."""
    message = conversion.world_to_message(SPEC, 1, 0, 0)
    text = f'name {text}'
    if field == 'world':
        message.world = text
    elif field == 'settings':
        message.settings[0].name = text
    else:
        setattr(message, field, [text, *getattr(message, field)[1:]])
    if text.isprintable():
        conversion.world_from_message(message)
        return
    with pytest.raises(ValueError, match=f'^world: {field}: got .*expected printable') as caught:
        conversion.world_from_message(message)
    assert str(caught.value).isprintable()
