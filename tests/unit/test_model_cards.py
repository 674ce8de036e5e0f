# SPDX-License-Identifier: Apache-2.0
"""Model cards describe the policies beside them and hold measured figures."""
from __future__ import annotations

import pytest

import make_model_cards as cards
from ppo_agent_node.exporting import provenance
from ppo_agent_node.pilots.search import shipped_names
from rocket_sim_node import plain_yaml


@pytest.mark.parametrize('name', shipped_names())
def test_a_card_is_current(name: str) -> None:
    found = cards.results()[name]
    assert found['policy_sha256'] == cards.sha256(name), (
        'the policy has changed; run: python docs/make_model_cards.py --fly')
    assert list(found['tasks']) == list(cards.TASKS[name])
    assert cards.path_of(name).with_suffix('.md').read_text('utf-8') == cards.card(name), (
        'stale; run: python docs/make_model_cards.py')


def test_each_policy_has_its_provenance() -> None:
    assert set(provenance.shipped()) == set(shipped_names())
    for provenances in provenance.shipped().values():
        assert set(provenances) == set(provenance.KEYS)


@pytest.mark.parametrize('name', shipped_names())
def test_the_header_is_that_of_the_hub(name: str) -> None:
    """As huggingface.co/docs/hub/model-cards has it; values are read as YAML."""
    _, header, _ = cards.card(name).split('---\n', 2)
    metadata = plain_yaml.load(header)
    assert metadata['license'] == 'apache-2.0'
    assert 'reinforcement-learning' in metadata['tags']
    model, = metadata['model-index']
    assert model['name'] == name
    for task in model['results']:
        reward, landed = task['metrics']
        assert float(reward['value'].split(' +/- ')[0]) > 250
        assert landed['value'] > 0.9


def test_flights_are_those_of_the_card() -> None:
    """The first of the many, flown again: equal starts, equal policy."""
    again = cards.fly('lunar_lander', 20)['tasks']['default settings']
    assert again['landed'] == 20
    assert again['mean_return'] > 250
