# SPDX-License-Identifier: Apache-2.0
"""The instruments on the terminal, as lines of text."""
from __future__ import annotations

import pytest
from rich.text import Text

from ppo_agent_node.cockpit.debrief import FlightSummary
from ppo_agent_node.cockpit.debrief import Watch
from ppo_agent_node.cockpit.debrief import debrief
from ppo_agent_node.cockpit.display import Cockpit
from ppo_agent_node.cockpit.display import Tank
from ppo_agent_node.cockpit.display import View
from ppo_agent_node.cockpit.instruments import Brake
from ppo_agent_node.cockpit.instruments import Readings

BRAKE = Brake(20.0, 0.0, 1.0, 10.0)
"""Brakes by 10 m/s^2 what falls by 10 m/s^2, on 1 kg."""


def view(height: float, climb: float, throttle: float = 0.0, **others: object) -> View:
    """Return what is shown in flight."""
    readings = Readings(height, climb, (3.0, -4.0), (-0.01, 0.0), (0.0, 0.0), 2.0)
    return View(
        'title', 100.0, (3.0, 10.0, 15.0), readings,
        Tank(1.0, 500.0, 2000.0, throttle, 1.5, BRAKE), flying=True, **others)  # type: ignore[arg-type]


def show(shown: View, width: int = 80, height: int = 24) -> list[str]:
    """Return the screen without its colours."""
    return [Text.from_ansi(line).plain for line in Cockpit().lines(shown, (width, height))]


@pytest.mark.parametrize(('height', 'climb', 'throttle', 'advice'), [
    (90.0, 0.0, 0.0, ''),
    (85.0, -10.0, 0.0, 'full throttle in 2.00 s at the latest'),
    (45.01, -30.0, 0.0, 'full throttle in 0.00 s at the latest'),
    (44.999, -30.0, 0.0, 'BURN: now or never'),
    (25.0, -30.0, 0.0, 'TOO LATE: at least 20 m/s at the ground'),
    (50.0, -30.0, 1.0, 'braking: +5.0 m to spare'),
])
def test_the_advice_shows_the_time_left_to_brake(
        height: float, climb: float, throttle: float, advice: str) -> None:
    line, = (line for line in show(view(height, climb, throttle)) if ' height' in line)
    assert line.split(' m', 1)[1].strip() == advice


def test_narrow_terminals_show_short_advice() -> None:
    for height, climb, words in ((85.0, -10.0, 'full in 2.00 s'), (25.0, -30.0, 'LATE: 20 m/s')):
        lines = show(view(height, climb), 40)
        assert any(line.endswith(words) for line in lines), lines
        assert not any('…' in line for line in lines if ' title' not in line), lines


def test_the_scale_shows_height_and_stopping_distance() -> None:
    scale, = (line.strip() for line in show(view(60.0, -20.0)) if '◆' in line)
    # 20 m of 100 to stop from 20 m/s, at 60 m.
    cells = scale.removeprefix('▕')
    assert cells.index('◆') / len(cells) == pytest.approx(0.60, abs=0.02)
    assert cells.count('█') / len(cells) == pytest.approx(0.20, abs=0.02)
    late, = (line.strip() for line in show(view(10.0, -20.0)) if '◆' in line)
    assert '█◆█' in late


def test_figures_have_units_and_directions() -> None:
    text = '\n'.join(show(view(60.0, -20.0, 0.3)))
    for part in ('60.0 m', '↓ 20.0 m/s', '↗  5.0 m/s', '(+3.0, +4.0)', '500 kg', '30%', '1.50 s'):
        assert part in text, part
    assert '-0.0' not in text
    shown = view(60.0, -20.0)
    shown.readings = Readings(60.0, -20.0, (1.0, 0.0), (-1.0, 0.0), (0.0, 0.0), 0.0)
    assert '-0.0' not in '\n'.join(show(shown))


@pytest.mark.parametrize('size', [(120, 30), (80, 24), (40, 24), (20, 8), (5, 1), (300, 100)])
def test_the_screen_fits_any_terminal_size(size: tuple[int, int]) -> None:
    width, height = size
    for shown in (
        view(60.0, -20.0, summary='landed 1 of 2', message='a message ' * 20),
        view(60.0, -20.0, help=True, notes=[('', 'http://127.0.0.1/' + 'x' * 90)]),
    ):
        lines = show(shown, width, height)
        assert len(lines) <= height
        assert all(len(line) < max(width, 20) for line in lines)


def test_long_notes_are_wrapped() -> None:
    url = 'http://127.0.0.1:9090/?url=' + 'x' * 90
    shown = view(1.0, 0.0, help=True, notes=[('', url)])
    assert url in ''.join(line.strip() for line in show(shown))


def test_debrief_names_outcome_figures_and_why() -> None:
    watch = Watch()
    watch.see(3.0, Readings(44.0, -30.0, (0, 0), (0, 0), (0, 0), 0.0), BRAKE, 1.0, 0.0)
    watch.see(3.1, Readings(40.0, -31.0, (0, 0), (0, 0), (0, 0), 0.0), BRAKE, 1.0, 1.0)
    crash = FlightSummary('too_fast', -104.0, 6.2, 12.7, 1.0, 2.0, 700.0)
    expert = FlightSummary('landed', 294.9, 9.1, 0.01, 0.0, 0.1, 710.0)
    text = '\n'.join(line for _, line in debrief(crash, expert, watch))
    assert 'CRASHED: too fast   12.70 m/s, 1.0 °, 2.0 m off the centre' in text
    assert 'lit 0.10 s later' in text
    # 31^2 - 2 * 10 * 40 = 161.
    assert '13 m/s at the ground' in text
    assert 'expert   294.9' in text
    landed = debrief(expert, None, watch)
    assert 'LANDED' in landed[0][1]
    assert not any('last chance' in line for _, line in landed)
