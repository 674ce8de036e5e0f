# SPDX-License-Identifier: Apache-2.0
"""Mirrored observations give mirrored actions, before and after learning, as in the worlds."""
from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from ppo_agent_node import random_streams
from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.config.training_config import Config
from ppo_agent_node.imitation.cloning import clone
from ppo_agent_node.imitation.demonstrations import Demonstrations
from ppo_agent_node.ppo.learner import Learner
from ppo_agent_node.ppo.networks.symmetry import Representation
from ppo_agent_node.ppo.networks.symmetry import Symmetry
from ppo_agent_node.ppo.policies.factory import symmetry_of
from ppo_agent_node.ppo.rollout_buffer import Batch
from rocket_sim_node import worlds
from rocket_sim_node.worlds.rocket.world import RocketWorld

KINDS = [
    ('rocket', 'from_scratch', 'mirrors', 'standard', 4),
    ('rocket', 'from_scratch', 'turns', 'standard', 8),
    ('rocket', 'robust', 'turns', 'extended', 8),
    ('lunar_lander', 'default', 'mirrors', '', 2)]
N = 64


def moved(vector: torch.Tensor, by: Representation, element: int) -> torch.Tensor:
    """Return vectors `(S, D)` after a symmetry; further entries of `by` are left out."""
    size = vector.shape[1]
    return vector[:, by.source[element, :size]] * by.sign[element, :size]


def made(
    world: str, preset: str, kind: str, observation: str,
) -> tuple[Config, Learner, Symmetry, int]:
    config = load_preset(
        preset, world, symmetry=kind, hidden_sizes=(16, 24), batch_size=32, clone_batch_size=32,
        log_std_init=-1.0, target_kl=0.0, threads=1)
    seen = {'observation': observation} if observation else {}
    spec = worlds.make(world, 4, **seen).spec
    symmetry = symmetry_of(spec, config.network)
    assert symmetry is not None
    return config, Learner(spec, config), symmetry, spec.observation_size


def assert_equivariant(learner: Learner, symmetry: Symmetry, size: int) -> None:
    """Check actions and values of random observations; some must be far from zero."""
    seen = 0.5 * torch.randn(N, size, generator=random_streams.generator(1, 'seen'))
    with torch.no_grad():
        outputs, values = learner.policy.output(seen), learner.critic(seen)
        assert outputs.abs().max() > 0.005
        for element in range(symmetry.order):
            other = moved(seen, symmetry.inputs, element)
            torch.testing.assert_close(
                learner.policy.output(other), moved(outputs, symmetry.actions, element),
                rtol=0, atol=1e-4)
            torch.testing.assert_close(learner.critic(other), values, rtol=0, atol=1e-4)


@pytest.mark.parametrize(('world', 'preset', 'kind', 'observation', 'order'), KINDS)
def test_networks_are_equivariant_before_and_after_an_update(
        world: str, preset: str, kind: str, observation: str, order: int) -> None:
    """The samples of the update are anything but symmetric."""
    _, learner, symmetry, size = made(world, preset, kind, observation)
    assert symmetry.order == order
    assert_equivariant(learner, symmetry, size)
    noise = random_streams.generator(2, 'samples')
    continuous = learner.policy.action_shape != ()
    batch = Batch(
        observation=torch.randn(N, size, generator=noise),
        action=torch.randn(N, 3, generator=noise) if continuous else torch.arange(N) % 4,
        log_prob=torch.full((N,), -1.0), value=torch.zeros(N),
        advantage=torch.randn(N, generator=noise), target=torch.randn(N, generator=noise))
    before = {name: tensor.clone() for name, tensor in learner.policy.state_dict().items()}
    learner.improve(1, batch, lambda: None)
    assert any(not torch.equal(tensor, before[name])
               for name, tensor in learner.policy.state_dict().items() if 'weight' in name)
    assert_equivariant(learner, symmetry, size)


def test_a_clone_and_its_normaliser_are_equivariant() -> None:
    """All demonstrations come from one side."""
    config, learner, symmetry, size = made('rocket', 'default', 'turns', 'standard')
    noise = random_streams.generator(3, 'demonstrations')
    demonstrations = Demonstrations(
        torch.rand(256, size, generator=noise), torch.rand(256, 3, generator=noise) - 0.2,
        torch.arange(256) // 8)
    clone(learner.policy, demonstrations, config.clone, 1, lambda epoch: None)
    learner.critic.normaliser.copy_from(learner.policy.normaliser)
    assert learner.policy.normaliser.mean.abs().max() > 0.1
    assert_equivariant(learner, symmetry, size)


def _mirrored(vector: NDArray[np.float64], plane: str, axial: bool) -> NDArray[np.float64]:
    """Return a vector `(3,)` after a mirror across x, z or x = z."""
    matrix = {'x': np.diag([-1.0, 1, 1]), 'z': np.diag([1.0, 1, -1]),
              'x=z': np.eye(3)[[2, 1, 0]]}[plane]
    return (-matrix if axial else matrix) @ vector


def test_mirrored_rockets_fly_mirrored_paths() -> None:
    """Mirror images in position, velocity, attitude and spin stay mirror images in flight."""
    world = worlds.make('rocket', 4, level=8, tilt_limit=180.0)
    assert isinstance(world, RocketWorld)
    rng = np.random.default_rng(1)
    position, velocity, spin = rng.normal(0, 5, (3, 3))
    axis = rng.normal(0, 0.2, 3)
    turn = np.sqrt(1 - axis @ axis)
    for row, plane in enumerate(('', 'x', 'z', 'x=z')):
        def put(vector: NDArray[np.float64], axial: bool, plane: str = plane) -> Any:
            return _mirrored(vector, plane, axial) if plane else vector
        world.position[:, row] = put(position, False) + [0, 120.0, 0]
        world.velocity[:, row] = put(velocity, False)
        world.spin[:, row] = 0.1 * put(spin, True)
        world.attitude[:, row] = [*put(axis, True), turn]
    spec = world.spec
    symmetry = symmetry_of(spec, dataclasses.replace(
        load_preset('default', 'rocket').network, symmetry='turns'))
    assert symmetry is not None
    # The elements after the identity are the three mirrors, in this order.
    actions = torch.from_numpy(rng.uniform(-1, 1, (40, 3)).astype(np.float32))
    for action in actions:
        seen, _, terminated, _, _ = world.step(torch.cat(
            [moved(action[None], symmetry.actions, element) for element in range(4)]).numpy())
        assert not terminated.any()
        for element in range(1, 4):
            np.testing.assert_allclose(
                seen[element], moved(torch.from_numpy(seen[:1]), symmetry.inputs, element)[0],
                rtol=0, atol=1e-5)


def test_units_that_do_not_divide_among_the_symmetries_are_refused() -> None:
    with pytest.raises(ValueError, match=(
            "hidden_sizes: got 30, expected a multiple of 4 with symmetry: 'mirrors'")):
        Learner(worlds.make('rocket', 4).spec, load_preset(
            'from_scratch', 'rocket', symmetry='mirrors', hidden_sizes=(32, 30)))


@pytest.mark.parametrize(('world', 'preset', 'setting', 'value', 'missing'), [
    ('lunar_lander', 'default', 'hidden_observations', 'left_contact', 'right_contact'),
    ('rocket', 'from_scratch', 'fine_observations', 'pad_y position_x', 'position_z')])
def test_observations_of_one_side_only_are_refused(
        world: str, preset: str, setting: str, value: str, missing: str) -> None:
    spec = worlds.make(world, 4).spec
    kind = 'turns' if world == 'rocket' else 'mirrors'
    with pytest.raises(ValueError, match=f'^{setting}: got .*, expected also {missing} with'):
        Learner(spec, load_preset(preset, world, symmetry=kind, **{setting: value}))
    Learner(spec, load_preset(preset, world, symmetry=kind, **{setting: f'{value} {missing}'}))


def test_features_of_a_rocket_are_refused_for_a_lander_with_symmetry() -> None:
    with pytest.raises(ValueError, match=r"^features: got 'descent', expected 'none' for a world"):
        Learner(worlds.make('lunar_lander', 4).spec, load_preset(
            'default', 'lunar_lander', features='descent'))


def test_first_weights_have_the_size_of_those_without_symmetry() -> None:
    spec = worlds.make('rocket', 4).spec
    sizes = {}
    for kind in ('none', 'mirrors', 'turns'):
        learner = Learner(spec, load_preset('from_scratch', 'rocket', symmetry=kind))
        sizes[kind] = [float(layer.weight.detach().square().mean().sqrt())
                       for layer in learner.policy.network.linear[:2]]
    for kind in ('mirrors', 'turns'):
        assert sizes[kind] == pytest.approx(sizes['none'], rel=0.3)
    assert all(math.isfinite(value) for value in sizes['none'])
