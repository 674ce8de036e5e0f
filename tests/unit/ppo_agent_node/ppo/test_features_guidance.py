# SPDX-License-Identifier: Apache-2.0
"""Features of guidance: the zero-effort miss and the stopping lean."""
from __future__ import annotations

import numpy as np
import pytest
import torch

from ppo_agent_node.ppo.networks.features import make_features
from ppo_agent_node.ppo.networks.mlp import Normaliser
from rocket_sim_node import worlds


def test_the_miss_is_the_offset_plus_drift_times_the_time_to_go() -> None:
    """At 100 m and 20 m/s: t = 2 h / (v + sqrt(g h / 2)) with a centimetre on the height."""
    env = worlds.make('rocket', num_envs=1)
    env.position[:, 0] = 4.0, 105.2, -3.0
    env.velocity[:, 0] = 1.5, -20.0, 0.5
    features = make_features('guidance', env.spec.observation_names, env.spec.settings)
    assert features is not None
    found = features(torch.from_numpy(env.observe()))[0].numpy()
    time = 2 * 100.01 / (20.0 + np.sqrt(0.5 * 9.81 * 100.01))
    assert np.sinh(found[-4:-2]) == pytest.approx(
        [4.0 + 1.5 * time, -3.0 + 0.5 * time], rel=1e-3)
    plain = make_features('descent', env.spec.observation_names, env.spec.settings)
    assert plain is not None
    assert found[:-4] == pytest.approx(plain(torch.from_numpy(env.observe()))[0].numpy())


def test_features_are_of_order_one_before_the_normaliser_is_fitted() -> None:
    """At starts of the whole task, no feature exceeds 5 and those of guidance vary."""
    env = worlds.make('rocket', num_envs=500, level=7)
    normaliser = Normaliser(15, make_features(
        'guidance', env.spec.observation_names, env.spec.settings))
    seen = normaliser(torch.from_numpy(env.observe()))[:, 15:]
    assert float(seen.abs().max()) < 5.0
    assert (seen[:, -8:].std(0) > 0.05).all()


def test_the_stopping_lean_is_where_braking_thrusters_stop_a_turn() -> None:
    """Flown: 0.25 rad/s by 4 rad/s^2 turn 8 mrad further before the rocket turns back."""
    env = worlds.make('rocket', num_envs=1, dt=0.001, spawn_angle=0.0)
    env.spin[:, 0] = -0.25, 0.0, 0.25
    features = make_features('guidance', env.spec.observation_names, env.spec.settings)
    assert features is not None
    predicted = 0.1 * np.sinh(features(torch.from_numpy(env.observe()))[0, -2:].numpy())
    furthest = np.zeros(2)
    for _ in range(100):
        up = env.step(np.array([[0.0, 1.0, -1.0]], np.float32))[0][0, [6, 8]]
        furthest = np.where(np.abs(up) > np.abs(furthest), up, furthest)
    assert np.abs(predicted) == pytest.approx([0.0078, 0.0078], abs=1e-4)
    assert furthest == pytest.approx(predicted, abs=3e-4)
