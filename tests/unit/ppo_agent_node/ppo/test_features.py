# SPDX-License-Identifier: Apache-2.0
"""Features of a descent: their closed forms, and that a policy file holds what they need."""
from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.ppo.learner import Learner
from ppo_agent_node.ppo.networks.features import DescentFeatures
from ppo_agent_node.ppo.networks.features import asinh
from ppo_agent_node.ppo.networks.features import make_features
from ppo_agent_node.ppo.networks.mlp import Normaliser
from ppo_agent_node.ppo.policies.factory import without_noise
from ppo_agent_node.ppo.policies.file import load_policy
from ppo_agent_node.ppo.policies.file import save_policy
from ppo_agent_node.threads import tensor_threads
from rocket_sim_node import worlds

WORLD = worlds.make('rocket', num_envs=4, seed=3, level=8)
SPEC = WORLD.spec


def features() -> DescentFeatures:
    return DescentFeatures(SPEC.observation_names, SPEC.settings)


def observe(**values: float) -> torch.Tensor:
    """Return an observation `(1, 15)` with these physical values, SI, the rest 0."""
    scale = {'pad': 50.0, 'position': 50.0, 'velocity': 20.0, 'spin': 10.0}
    seen = torch.zeros(1, 15)
    for name, value in values.items():
        seen[0, SPEC.observation_names.index(name)] = value / scale.get(name.split('_')[0], 1.0)
    return seen


def test_the_needed_deceleration_is_v2_over_2h() -> None:
    """From 20 m/s at 40 m: 5 m/s^2, in units of g."""
    found = features()(observe(pad_y=-40.0, velocity_y=-20.0))[0]
    assert found[10] == pytest.approx(math.asinh(5.0 / 9.81), rel=1e-3)


def test_the_flare_rate_is_speed_over_height_down_to_millimetres() -> None:
    near = features()(observe(pad_y=-0.004, velocity_y=-0.2))[0]
    assert near[12] == pytest.approx(math.asinh(0.2 / 0.005), rel=1e-3)
    assert near[0] == pytest.approx(math.asinh(0.004 / 0.002), rel=1e-3)
    assert near[3] == pytest.approx(math.asinh(0.2 / 0.005), rel=1e-3)


def test_distance_weighs_with_the_square_of_the_time_to_go_and_drift_with_it() -> None:
    """The time to go is 2 h / (v + sqrt(g h / 2))."""
    found = features()(observe(
        pad_y=-50.0, velocity_y=-20.0, position_x=3.0, velocity_z=1.5))[0]
    time = 2 * 50.01 / (20 + math.sqrt(0.5 * 9.81 * 50.01))
    assert found[11] == pytest.approx(math.asinh(time), rel=1e-3)
    assert found[13] == pytest.approx(math.asinh(3.0 / (9.81 * time**2) / 0.1), rel=1e-3)
    assert found[16] == pytest.approx(math.asinh(1.5 / (9.81 * time) / 0.1), rel=1e-3)
    assert found[14] == found[15] == 0.0


def test_features_are_finite_at_and_below_the_ground_and_in_a_climb() -> None:
    for height in (0.0, -3.0):
        for speed in (0.0, -30.0, 30.0):
            assert features()(observe(pad_y=-height, velocity_y=speed)).isfinite().all()


def test_a_world_without_rockets_has_no_features() -> None:
    spec = worlds.make('lunar_lander').spec
    with pytest.raises(ValueError, match=r"features: got 'descent', expected 'none' .* pad_y"):
        make_features('descent', spec.observation_names, spec.settings)
    with pytest.raises(ValueError, match=r"features: got 'guidance', expected 'none' .* pad_y"):
        make_features('guidance', spec.observation_names, spec.settings)
    assert make_features('none', spec.observation_names, spec.settings) is None


def test_the_fast_path_normalises_as_the_module_does() -> None:
    observation = torch.tensor(WORLD.observe())
    normaliser = Normaliser(15, features())
    normaliser.width[13] = 0.02
    normaliser.fit(observation)
    learner = Learner(SPEC, load_preset('quick', features='descent', hidden_sizes=(16,)))
    learner.policy.normaliser.copy_from(normaliser)
    expected = learner.policy.network(normaliser(observation))
    torch.testing.assert_close(
        learner.policy.quick_output()(observation), expected)
    assert normaliser(observation).shape == (4, 15 + features().count)


@pytest.mark.parametrize('kind', ['descent', 'guidance'])
@pytest.mark.parametrize('shape', [(15,), (0, 15), (1, 15), (3, 15), (257, 15), (2, 5, 15)])
def test_in_flight_the_features_are_the_same_bit_for_bit(
    kind: str, shape: tuple[int, ...],
) -> None:
    """Also below the ground, in a climb, and at speeds far beyond those of a descent."""
    generator = torch.Generator().manual_seed(3)
    module = make_features(kind, SPEC.observation_names, SPEC.settings)
    assert module is not None
    in_flight = module.in_flight()
    for scale in (1e-6, 1.0, 1e3):
        observation = scale * torch.randn(shape, generator=generator)
        found, expected = in_flight(observation), module(observation)
        assert found.shape == expected.shape
        assert torch.equal(  # -0.0 is equal to 0.0
            found.contiguous().view(torch.int32), expected.contiguous().view(torch.int32))
    observation.fill_(math.nan)
    assert bool(in_flight(observation).isnan().all())


def test_a_policy_file_keeps_its_features_and_older_files_have_none(tmp_path: Path) -> None:
    config = load_preset('default', features='descent', hidden_sizes=(16,))
    policy = Learner(SPEC, config).policy
    policy.normaliser.fit(torch.tensor(WORLD.observe()))
    path = tmp_path / 'policy.safetensors'
    save_policy(path, policy, SPEC, config.network, 1, {})
    loaded, content = load_policy(path, SPEC)
    assert content['features'] == 'descent'
    observation = WORLD.observe()
    np.testing.assert_array_equal(
        without_noise(loaded)(observation), without_noise(policy)(observation))
    plain = dataclasses.replace(config.network, features='none')
    save_policy(path, Learner(SPEC, dataclasses.replace(config, network=plain)).policy, SPEC,
                plain, 1, {})
    assert load_policy(path, SPEC)[0].normaliser.features is None


def test_asinh_is_as_accurate_as_pytorchs() -> None:
    size = torch.logspace(-30, 18, 20_001)
    x = torch.cat((size, -size, torch.zeros(1)))
    expected = x.double().asinh()
    found = asinh(x)
    assert found.dtype == torch.float32
    assert bool(((found - expected).abs() <= 2e-7 * expected.abs()).all())
    assert bool(asinh(torch.tensor([math.nan])).isnan().all())

def test_a_policy_flies_with_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """With more, threads of a small network wait for each other longer than they compute."""
    policy = Learner(SPEC, load_preset('default', 'rocket')).policy
    threads: list[int] = []
    most_likely = policy.most_likely

    def watched(output: torch.Tensor) -> torch.Tensor:
        threads.append(torch.get_num_threads())
        return most_likely(output)

    monkeypatch.setattr(policy, 'most_likely', watched)
    with tensor_threads(2):
        without_noise(policy)(WORLD.reset(1))
        assert threads == [1]
        assert torch.get_num_threads() == 2
