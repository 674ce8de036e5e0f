# SPDX-License-Identifier: Apache-2.0
"""A policy in a world with more observations than it uses gets its own columns."""
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from support.training.reports import flown

from ppo_agent_node.config.training_config import NetworkConfig
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.expert.expert import ExpertPilot
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.pilots.policy import columns
from ppo_agent_node.pilots.search import find_policy
from ppo_agent_node.ppo.policies.factory import make_policy
from ppo_agent_node.ppo.policies.file import load_policy
from ppo_agent_node.ppo.policies.file import save_policy
from rocket_sim_node import worlds
from rocket_sim_node.worlds import WorldSpec


def saved(path: Path, spec: WorldSpec) -> Path:
    """Save a small policy of a world."""
    network = NetworkConfig(hidden_sizes=(8,))
    policy = make_policy(spec, network, torch.Generator().manual_seed(1))
    save_policy(path, policy, spec, network, 1, {})
    return path


def test_actions_are_within_their_bounds_and_nan_stays(tmp_path: Path) -> None:
    spec = worlds.make('rocket').spec
    network = NetworkConfig(hidden_sizes=(8,))
    policy = make_policy(spec, network, torch.Generator().manual_seed(1))
    with torch.no_grad():
        policy.network.linear[-1].bias.copy_(torch.tensor([30.0, -30.0, 0.25]))
    save_policy(tmp_path / 'bold.safetensors', policy, spec, network, 1, {})
    pilot = PolicyPilot(tmp_path / 'bold.safetensors', spec)
    observation = np.zeros((2, spec.observation_size), np.float32)
    observation[1] = np.nan
    action = pilot(observation)
    assert action.dtype == np.float32
    assert action[0, :2].tolist() == [1.0, -1.0]
    assert -1.0 < action[0, 2] < 1.0
    assert np.isnan(action[1]).all()


@pytest.mark.parametrize(('wanted', 'given', 'found'), [
    ('abc', 'abc', None), ('ab', 'abc', slice(0, 2)), ('bc', 'abc', slice(1, 3)),
    ('ca', 'abc', [2, 0]), ('c', 'abc', slice(2, 3)), ('ac', 'abc', [0, 2])])
def test_columns_are_found_by_name(wanted: str, given: str, found: object) -> None:
    assert columns(tuple(wanted), tuple(given)) == found


def test_a_missing_column_is_refused() -> None:
    with pytest.raises(ValueError, match='not in'):
        columns(('a', 'x'), ('a', 'b'))


@pytest.mark.slow
@pytest.mark.parametrize('world', ['rocket', 'rocket_planar'])
def test_policy_and_expert_fly_the_same_with_more_columns(world: str) -> None:
    short = {'spawn_height': 30.0, 'time_limit': 3.0}
    plain = worlds.make(world, 5, 3, **short)
    rich = worlds.make(world, 5, 3, **short, observation='extended')
    path = find_policy('default', world)
    for pilot in (lambda spec: PolicyPilot(path, spec), ExpertPilot):
        one = evaluate(plain, pilot(plain.spec), 5, 4, level=8)
        other = evaluate(rich, pilot(rich.spec), 5, 4, level=8)
        assert other.final_observation.shape[1] == rich.spec.observation_size > 15
        assert np.array_equal(one.final_observation, other.final_observation[:, :15])
        assert np.array_equal(one.episodes.episode_return, other.episodes.episode_return)


def test_columns_in_another_order_are_taken_in_the_policys_order(tmp_path: Path) -> None:
    spec = worlds.make('rocket').spec
    path = saved(tmp_path / 'policy.safetensors', spec)
    names = spec.observation_names
    shuffled = WorldSpec(**{**spec.__dict__, 'observation_names': (*names[::-1], 'more')})
    seen = flown().first_observation
    turned = np.concatenate((seen[:, ::-1], np.full((len(seen), 1), 7.0, np.float32)), axis=1)
    assert np.array_equal(PolicyPilot(path, spec)(seen), PolicyPilot(path, shuffled)(turned))


def test_a_policy_that_needs_more_columns_names_the_setting(tmp_path: Path) -> None:
    rich = worlds.make('rocket', observation='extended').spec
    path = saved(tmp_path / 'policy.safetensors', rich)
    assert load_policy(path, rich)[1]['observation_names'] == list(rich.observation_names)
    with pytest.raises(ValueError, match=(
            r'policy.safetensors: observation_names: the policy also sees command_1_throttle, '
            r'.* and 18 more; expected .*observation:=extended')):
        PolicyPilot(path, worlds.make('rocket').spec)


def test_observation_and_conditions_do_not_count_as_unfamiliar(tmp_path: Path) -> None:
    path = saved(tmp_path / 'policy.safetensors', worlds.make('rocket').spec)
    assert not PolicyPilot(path, worlds.make('rocket', observation='extended').spec).unfamiliar
    assert not PolicyPilot(path, worlds.make('rocket', conditions='harsh').spec).unfamiliar
    assert 'spin_scale' in PolicyPilot(path, worlds.make('rocket', spin_scale=5.0).spec).unfamiliar
