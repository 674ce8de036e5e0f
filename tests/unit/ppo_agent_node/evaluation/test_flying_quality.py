# SPDX-License-Identifier: Apache-2.0
"""Dry tanks, hovering, ignitions and effort, against closed forms."""
from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from support.training.reports import flown

from ppo_agent_node.evaluation import failures
from ppo_agent_node.evaluation.flying_quality import figures
from ppo_agent_node.evaluation.flying_quality import rows
from ppo_agent_node.evaluation.metrics import summarise
from ppo_agent_node.evaluation.metrics import table
from ppo_agent_node.evaluation.runner import EvaluationResult
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.reporting.pages import figures_table
from rocket_sim_node import worlds
from rocket_sim_node.worlds.base import F32
from rocket_sim_node.worlds.rocket.episode_counters import EpisodeCounters


class Steady:
    """Answers the same action at every step."""

    name = 'steady'

    def __init__(self, *action: float) -> None:
        self._action = np.array(action, np.float32)

    def __call__(self, observation: F32) -> F32:
        return np.tile(self._action, (len(observation), 1))


def made(count: int = 60) -> EvaluationResult:
    """Return episodes of which each tenth ended dry, and each third did not land."""
    result, number = flown(), np.arange(count)
    outcomes = result.spec.outcomes
    outcome = np.where(number % 3 == 2, outcomes.index('tipped'), outcomes.index('landed'))
    outcome[5] = outcomes.index('too_fast')
    return dataclasses.replace(result, episodes=dataclasses.replace(
        result.episodes, outcome=outcome.astype(np.uint8), episode_return=1.0 * number,
        fuel_left=np.where(number % 10 == 0, 0.0, 100.0), hover_time=0.5 * number,
        ignitions=number % 2 + 1, control_effort=np.full(count, 0.25)))


def test_rates_and_spreads_are_those_of_the_episodes() -> None:
    found = figures(made())
    assert found['tanks_dry'] == 0.1
    # Wilson's closed form for 6 of 60 at z = 1.96.
    z, n, p = 1.959963984540054, 60, 0.1
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    assert found['tanks_dry_interval'] == pytest.approx([centre - half, centre + half])
    assert found['mean_return_tanks_dry'] == 25.0  # of 0, 10, 20, 30, 40, 50
    assert found['hover_time'] == {'mean': 14.75, 'p95': pytest.approx(0.5 * 0.95 * 59)}
    assert found['ignitions'] == {'mean': 1.5, 'p95': 2.0}
    assert found['control_effort'] == {'mean': 0.25, 'p95': 0.25}


def test_each_rate_has_the_mean_return_of_its_episodes() -> None:
    summary = summarise(made())
    assert summary['landing_rate'] == 40 / 60
    landed = [number for number in range(60) if number % 3 != 2]
    assert summary['mean_return_landed'] == pytest.approx(np.mean(landed))
    assert summary['return_p05'] == pytest.approx(0.05 * 59)
    assert summary['standing_rate'] == 1.0, 'the contact model looks at where they came down'
    assert summary['mean_return_standing'] == summary['mean_return'] == 29.5
    text = ' '.join(table(summary).split())
    assert 'landed: 29.00' in text and '5 %: below 2.95' in text
    assert 'tanks dry 10.00 % [4.66, 20.15]' in text
    assert 'hovering 14.8 s (95 %: below 28)' in text
    shown = {row[0]: row[1:] for row in figures_table.rows(summary, None)}
    assert shown['ended with dry tanks'] == ('10.00 %', '4.66 to 20.15 %', '')
    assert shown['mean return, landed'][0] == '29.00'
    assert shown['mean return, with dry tanks'][0] == '25.00'
    assert 'mean return, standing' not in shown, 'all stand: it is the mean return'


def test_full_throttle_empties_every_tank_and_none_leaves_it_full() -> None:
    """Full throttle burns 50 kg in 15 steps, long before anything is reached."""
    world = worlds.make('rocket', 8, fuel=50.0, time_limit=2.0, tilt_limit=180.0)
    burnt = evaluate(world, Steady(1.0, 0.0, 0.0), 8, 1, level=1)
    assert burnt.dry is not None and burnt.dry.all()
    assert burnt.episodes.fuel_used == pytest.approx(50.0)
    assert figures(burnt)['tanks_dry'] == 1.0
    assert figures(burnt)['ignitions'] == {'mean': 1.0, 'p95': 1.0}
    coasted = evaluate(world, Steady(-1.0, 0.5, -0.25), 8, 1, level=1)
    assert coasted.episodes.fuel_left.tolist() == [50.0] * 8
    found = figures(coasted)
    assert (found['tanks_dry'], found['mean_return_tanks_dry']) == (0.0, None)
    assert found['ignitions']['mean'] == found['hover_time']['mean'] == 0.0
    assert found['control_effort']['mean'] == pytest.approx(0.75), 'both torques, at every step'


def test_a_world_without_tanks_has_nulls() -> None:
    summary = summarise(flown('lunar_lander', 'random'))
    assert summary['conditions'] is summary['tanks_dry'] is summary['tanks_dry_interval'] is None
    assert summary['mean_return_standing'] is summary['mean_return_tanks_dry'] is None
    for name in ('hover_time', 'ignitions', 'control_effort'):
        assert summary[name] == {'mean': None, 'p95': None}
    assert rows(summary) == []
    assert 'dry' not in table(summary) and 'speed at the end' in table(summary)
    assert json.dumps(summary, allow_nan=False)


@pytest.mark.slow
def test_conditions_are_named() -> None:
    world = worlds.make('rocket', 4, spawn_height=20.0)
    for settings, name in (
            ({}, 'nominal'), ({'conditions': 'mix'}, 'mix'), ({'engine_lag': 0.1}, 'custom')):
        summary = summarise(evaluate(world, Steady(-1.0, 0.0, 0.0), 4, 1, level=7, **settings))
        assert summary['conditions'] == name
        assert ('conditions' in table(summary)) == (name != 'nominal')


def test_noisy_sensors_give_no_standing_rate() -> None:
    world = worlds.make('rocket', 4, spawn_height=20.0)
    result = evaluate(world, Steady(-1.0, 0.0, 0.0), 4, 1, level=7, sensor_noise=0.25)
    summary = summarise(result)
    assert result.settled is None
    assert (summary['standing_rate'], summary['tanks_dry']) == (None, 0.0)
    assert 'touchdown speed' in table(summary)


def test_failed_starts_take_the_outcomes_in_turn() -> None:
    result = made()
    order = np.lexsort((result.episodes.row, result.episodes.episode))
    found = failures.failed_starts(result)
    assert len(found) == failures.MOST
    assert {one['outcome'] for one in found[:2]} == {'tipped', 'too_fast'}
    assert [one['outcome'] for one in found[2:]] == ['tipped'] * 10
    tipped = [int(place) for place in order if place % 3 == 2 and place != 5]
    assert [(one['row'], one['episode'], one['return']) for one in found if one[
        'outcome'] == 'tipped'] == [
            (int(result.episodes.row[place]), int(result.episodes.episode[place]), float(place))
            for place in tipped[:11]]
    assert failures.failed_starts(flown()) == []


def test_hovering_is_slow_powered_flight_above_touchdown_height() -> None:
    log = EpisodeCounters(5)
    speed, height = np.array((1.9, 2.1, 0.1, 0.1, 0.1)), np.array((50.0, 50.0, 5.01, 5.0, 50.0))
    for _ in range(3):
        log.note_flight(speed, height, np.array((1.0, 1.0, 0.1, 1.0, 0.0)), np.ones(5, bool), 5.0)
    assert log.hover_time(np.arange(5), 0.02) == pytest.approx([0.06, 0.0, 0.06, 0.0, 0.0])
    log.begin(np.array([0]))
    assert log.hover_time(np.array([0, 2]), 0.02) == pytest.approx([0.0, 0.06])
