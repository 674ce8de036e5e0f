# SPDX-License-Identifier: Apache-2.0
"""The display of a run in a terminal."""
from __future__ import annotations

import io
import math
import re
from dataclasses import replace

import pytest
from rich.console import Console
from rich.text import Text

from ppo_agent_node.terminal import Terminal
from ppo_agent_node.terminal import formatting
from ppo_agent_node.terminal.live_display import LiveDisplay
from ppo_agent_node.terminal.sparkline import sparkline
from ppo_agent_node.terminal.status_lines import NARROW
from ppo_agent_node.terminal.status_lines import StatusLines
from ppo_agent_node.training.stop_criterion import StopCriterion
from rocket_sim_node.telemetry.training_status import Status

STAGES = ('demonstrate', 'clone', 'finetune', 'evaluate')
STATUS = Status(
    run='first', folder='/home/somebody/runs/first', stages=STAGES, stage='finetune',
    iteration=3, iterations=50, progress=3, goal=50, unit='iterations', steps=1_234_567, level=4,
    landing_rate=0.9876, landing_rate_low=0.95, landing_rate_high=0.999, mean_return=281.26,
    steps_per_second=123456.7, elapsed=61.0, remaining=125.0, selection_iteration=2,
    selection_landing_rate=1.0, selection_landing_rate_low=0.97,
    selection_landing_rate_high=1.0, selection_return=290.0, best_iteration=2,
    best_landing_rate=1.0, best_return=290.0, saved='checkpoints/iteration_000002.safetensors')


def picture(clock: list[float], *statuses: Status) -> StatusLines:
    shown = StatusLines(clock=lambda: clock[0])
    for status in statuses:
        shown.take(status)
    return shown


def text(shown: StatusLines, width: int) -> str:
    return '\n'.join(line.plain for line in shown.lines(width))


def test_unknown_figures_are_left_out() -> None:
    assert formatting.figures(Status(stage='finetune')) == []
    assert formatting.without_noise(Status()) == formatting.best(Status()) == ''
    assert formatting.figures(STATUS) == [
        'level 4', 'landed 98.8% [95.0, 99.9]', 'return 281.3', '123,457 steps/s']


@pytest.mark.parametrize(('count', 'expected'), [
    (999, '999'), (1000, '1 k'), (12_345, '12.3 k'), (999_499, '999 k'), (999_600, '1 M'),
    (3_210_000_000, '3.21 G')])
def test_amounts(count: int, expected: str) -> None:
    assert formatting.amount(count) == expected


@pytest.mark.parametrize(('seconds', 'expected'), [
    (0.9, '0:00'), (61.0, '1:01'), (3599.9, '59:59'), (3661.0, '1:01:01'), (-5.0, '0:00')])
def test_durations(seconds: float, expected: str) -> None:
    assert formatting.duration(seconds) == expected


def test_a_log_gets_one_plain_line_a_report() -> None:
    file = io.StringIO()
    with Terminal(file) as terminal:
        terminal.wait_for('a simulator', Status())
        terminal.show(replace(STATUS, message='level 4 -> 5'))
        terminal.show(replace(STATUS, remaining=math.nan, message='saved policy.safetensors'))
        terminal.show(replace(STATUS, remaining=math.nan))
        terminal.say('[not] markup')
    assert file.getvalue().splitlines() == [
        '[1:01] PPO 3/50: level 4, landed 98.8% [95.0, 99.9], return 281.3, 123,457 steps/s, '
        '2:05 left; level 4 -> 5',
        '[1:01] PPO 3/50: saved policy.safetensors',
        '[not] markup',
    ]


def test_time_left_is_shown_once_it_can_be_estimated() -> None:
    unknown = replace(STATUS, iteration=0, progress=0, remaining=math.inf)
    assert formatting.line(unknown).endswith('return 281.3, 123,457 steps/s')
    for width in (NARROW - 1, 100):
        assert 'left' not in text(picture([0.0], unknown), width)
        assert '2:05 left' in text(picture([0.0], STATUS), width)


def test_a_long_stage_logs_few_lines_with_its_events_and_both_ends() -> None:
    file = io.StringIO()
    with Terminal(file) as terminal:
        for k in range(1, 1001):
            terminal.show(replace(
                STATUS, iteration=k, iterations=1000, progress=k, goal=1000,
                message='level 1 -> 2' if k == 500 else ''))
    counts = [line.split(':')[1].split()[-1] for line in file.getvalue().splitlines()]
    assert counts[0] == '1/1000'
    assert counts[-1] == '1000/1000'
    assert '500/1000' in counts
    assert len(counts) < 20


class Latin(io.TextIOWrapper):
    """A terminal with the characters of Latin-1 only."""

    def isatty(self) -> bool:
        return True


def test_a_terminal_without_an_ellipsis_gets_a_replacement(
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('TERM', 'xterm')
    file = Latin(io.BytesIO(), encoding='latin-1')
    with Terminal(file) as terminal:
        assert terminal.live
        terminal.show(replace(STATUS, message='long ' * 50))
    file.seek(0)
    assert re.search('long (long )+l?o?n?g?\\?', file.read())


@pytest.mark.parametrize('width', [200, 120, 100, 80, 60, 59, 50, 30, 10, 1])
def test_no_line_is_wider_than_the_terminal(width: int) -> None:
    statuses = [replace(STATUS, iteration=k, mean_return=float(k)) for k in range(99)]
    shown = picture([0.0], *statuses)
    lines = shown.lines(width)
    assert all(line.cell_len <= width for line in lines)
    assert len(lines) <= (2 if width < NARROW else 9)


def test_at_80_columns_everything_is_shown() -> None:
    shown = text(picture([0.0], replace(STATUS, mean_return=100.0), STATUS), 80)
    for part in (
        '✓ expert flies   ✓ cloning   ▶ PPO   · evaluating', '3/50 iterations', '6%', '1:01 gone',
        '2:05 left', 'level 4', 'landed 98.8% [95.0, 99.9]', 'return 281.3', '123,457 steps/s',
        '1.23 M steps', 'without noise, at iteration 2: landed 100.0% [97.0, 100.0]',
        'return 290.0', 'best 290.0 at iteration 2', '100.0 → 281.3', '99% → 99%',
        'checkpoints/iteration_000002.safetensors',
    ):
        assert part in shown, part
    assert '/home/somebody/runs/first' in text(picture([0.0], STATUS), 120)


def test_a_narrow_display_has_two_lines() -> None:
    assert text(picture([0.0], STATUS), 50).splitlines() == [
        'PPO 3/50 2:05 left', 'level 4 landed 99% return 281 best 290']
    assert text(picture([0.0], STATUS), 20).splitlines() == [
        'PPO 3/50 2:05 left', 'level 4 landed 99%']


def test_clocks_run_between_reports_and_messages_keep_the_figures() -> None:
    clock = [100.0]
    shown = picture(clock, STATUS)
    clock[0] += 5.0
    shown.take(Status(
        stages=STAGES, stage='finetune', iteration=3, iterations=50, progress=3, goal=50,
        unit='iterations', elapsed=66.0, saved='policy.safetensors', message='saved'))
    clock[0] += 10.0
    seen = text(shown, 100)
    for part in ('1:16 gone', '1:50 left', 'return 281.3', 'saved   policy.safetensors'):
        assert part in seen, seen


def test_fine_tuning_counts_the_unit_that_ends_it() -> None:
    ending = StopCriterion(iterations=10_000, episodes=1000)
    assert ending.progress(0, 0) == (0, 1000, 'episodes')
    assert ending.progress(50, 400) == (400, 1000, 'episodes')
    assert ending.left(50, 400) == 75.0
    assert ending.progress(9000, 400) == (9000, 10_000, 'iterations')
    assert ending.reached(50, 1000)
    assert not ending.reached(9999, 999)
    assert StopCriterion(70, 0).progress(7, 400) == (7, 70, 'iterations')
    status = replace(STATUS, progress=400, goal=1000, unit='episodes')
    assert formatting.line(status).startswith('[1:01] PPO 400/1000 episodes: ')


def test_sparklines() -> None:
    assert sparkline([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], 8) == '▁▂▃▄▅▆▇█'
    assert sparkline([0.0, 0.0, 7.0, 7.0], 2) == '▁█'
    assert sparkline([0.5, math.nan, 0.5], 9, 0.0, 1.0) == '▅▅'
    assert sparkline([], 9) == sparkline([1.0, 2.0], 0) == sparkline([1.0, 2.0], -3) == ''
    assert sparkline([0.0, 7.0], 9, blocks=False).isascii()


class Screen:
    """A terminal that knows the few control codes that the display uses."""

    def __init__(self, written: str) -> None:
        self.rows, row, k = [''], 0, 0
        while k < len(written):
            if written.startswith('\x1b[', k):
                end = next(j for j in range(k + 2, len(written)) if written[j].isalpha())
                number, code = written[k + 2:end], written[end]
                if code == 'A':
                    row -= int(number)
                elif code == 'J':
                    self.rows = [*self.rows[:row], self.rows[row][:self.column]]
                elif code == 'K':
                    self.rows[row] = self.rows[row][:self.column]
                elif code == 'H':
                    row = self.column = 0
                k = end
            elif written[k] == '\r':
                self.column = 0
            elif written[k] == '\n':
                row, self.column = row + 1, 0
                if row == len(self.rows):
                    self.rows.append('')
            else:
                line = self.rows[row]
                self.rows[row] = line[:self.column] + written[k] + line[self.column + 1:]
                self.column += 1
            k += 1

    column = 0


def test_the_display_stays_in_place_below_the_lines_that_stay(
        monkeypatch: pytest.MonkeyPatch) -> None:
    file, size = io.StringIO(), [80, 24]
    console = Console(file=file, force_terminal=True, width=80, height=24, color_system=None)
    monkeypatch.setattr(LiveDisplay, '_size', lambda self: (size[0], size[1]))
    shown = picture([0.0], STATUS)
    display = LiveDisplay(console)
    for k in range(3):
        display.draw(shown.lines(display.width), Text(f'event {k}', no_wrap=True))
        display.draw(shown.lines(display.width))
    events = ['event 0', 'event 1', 'event 2']
    assert Screen(file.getvalue()).rows == [*events, *text(shown, 77).splitlines()]
    # A new size begins with a clear screen, whatever the terminal made of the old lines.
    size[:] = 50, 10
    display.draw(shown.lines(display.width))
    assert Screen(file.getvalue()).rows == [*events, *text(shown, 47).splitlines()]
    display.draw([])
    assert Screen(file.getvalue()).rows == [*events, '']
