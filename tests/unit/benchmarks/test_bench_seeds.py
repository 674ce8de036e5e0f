# SPDX-License-Identifier: Apache-2.0
"""Tasks of `bench seeds`, and the table of single conditions."""
from __future__ import annotations

from argparse import Namespace

from benchmarks import seeds

from rocket_sim_node.worlds.rocket import conditions


def test_single_conditions_become_tasks_of_their_own() -> None:
    tasks = seeds.spread(['nominal:7', 'single:7', 'mix:8'])
    assert (tasks[0], tasks[-1]) == ('nominal:7', 'mix:8')
    assert len(tasks) == 2 + len(conditions.SINGLE) - len({'nominal', 'mix', 'harsh'})
    assert 'lag 0.2 s:7' in tasks


def test_a_single_condition_is_flown_and_shown() -> None:
    options = Namespace(world='rocket', episodes=8, seed=3)
    flown = [
        {'pilot': 'scripted', 'task': task, **seeds.fly(options, 'scripted', task)}
        for task in ('nominal:1', 'delay 3 steps:1', 'mass +5 %:1')]
    # The expert does not know that the rocket is heavier.
    assert flown[2]['mean_return'] < flown[0]['mean_return']
    lines = seeds.single_markdown(flown).splitlines()
    assert [line.split('|')[1].strip() for line in lines] == [
        'condition', '-' * 13, 'delay 3 steps', 'mass +5 %']
