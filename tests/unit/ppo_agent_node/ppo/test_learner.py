# SPDX-License-Identifier: Apache-2.0
"""Adam, perceptrons and minibatches against torch's own; the learner's devices and checkpoints."""
from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import nn
from torch.nn.utils import clip_grad_norm_

from ppo_agent_node import random_streams
from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.ppo import learner as learner_module
from ppo_agent_node.ppo.learner import Learner
from ppo_agent_node.ppo.minibatches import Minibatches
from ppo_agent_node.ppo.networks.adam import FlatAdam
from ppo_agent_node.ppo.networks.backpropagation import Backpropagation
from ppo_agent_node.ppo.networks.mlp import mlp
from ppo_agent_node.ppo.policies.file import load_policy
from ppo_agent_node.ppo.policies.file import save_policy
from ppo_agent_node.ppo.rollout_buffer import Batch
from ppo_agent_node.training.run_state import _same
from ppo_agent_node.training.run_state import description
from rocket_sim_node import worlds

needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason='no GPU here')


def test_adam_is_torchs_with_a_rate_for_each_group_and_clipped_gradients() -> None:
    noise = random_streams.generator(1, 'x')
    shapes = ((5, 3), (7,), (1, 33), (3,))
    start = [torch.randn(shape, generator=noise) for shape in shapes]
    ours, theirs = ([nn.Parameter(value.clone()) for value in start] for _ in range(2))
    flat = FlatAdam([ours[:3], ours[3:]])
    adam = torch.optim.Adam([{'params': theirs[:3]}, {'params': theirs[3:]}], eps=1e-5)
    for step in range(20):
        rates, count = (1e-2 / (step + 1), 1e-3), 1 + step
        for group, rate in zip(adam.param_groups, rates, strict=True):
            group['lr'] = rate
        flat.gradient.zero_()
        for mine, other in zip(ours, theirs, strict=True):
            other.grad = (0.1 if step % 2 else 10.0) * torch.randn(
                other.shape, generator=noise)
            flat.gradient_of(mine).add_(other.grad, alpha=count)
        norm = clip_grad_norm_(theirs, 2.0)
        adam.step()
        assert flat.step(rates, 2.0, count) == pytest.approx(float(norm), rel=1e-5)
        for mine, other in zip(ours, theirs, strict=True):
            torch.testing.assert_close(mine, other, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize('activation', ['tanh', 'relu'])
@pytest.mark.parametrize('hidden', [(), (8,), (16, 8, 4), (64, 48)])
def test_perceptrons_are_sequential_networks(activation: str, hidden: tuple[int, ...]) -> None:
    noise = random_streams.generator(1, 'x')
    network = mlp((5, *hidden, 2), 1.0, noise, activation)
    for parameter in network.parameters():
        nn.init.normal_(parameter, 0, 0.5, noise)
    gradients = {id(p): torch.zeros_like(p) for p in network.parameters()}
    backpropagation = Backpropagation(network, lambda p: gradients[id(p)], 40)
    x, error = torch.randn(70, 5, generator=noise), torch.randn(70, 2, generator=noise)
    expected = network(x)
    expected.backward(error)
    with torch.no_grad():
        for part, its_error, wanted in zip(
                x.split(40), error.split(40), expected.split(40), strict=True):
            torch.testing.assert_close(backpropagation.forward(part).T, wanted)
            backpropagation.backward(its_error.T)
    for parameter in network.parameters():
        torch.testing.assert_close(gradients[id(parameter)], parameter.grad)


def test_minibatches_hold_each_sample_once_in_the_order_of_the_epoch() -> None:
    field, result = torch.arange(23.0), torch.zeros(23)
    minibatches = Minibatches((field, torch.arange(46).view(23, 2)), (result,), 10, 4)
    order = torch.randperm(23, generator=random_streams.generator(1, 'x'))
    for _ in range(2):
        assert torch.equal(minibatches.shuffle(order)[0], order.float())
        seen = []
        for start, stop, pieces in minibatches:
            assert [len(piece[0]) for piece in pieces] == (
                [4, 4, 2] if stop - start == 10 else [3])
            for one, two, out in pieces:
                assert torch.equal(two[:, 0], 2 * one.long())
                out.copy_(one)
                seen.append(one.clone())
        assert torch.equal(torch.cat(seen), order.float())
        assert torch.equal(result, order.float())
        order = order.flip(0)


@pytest.mark.parametrize('count', [23, 20, 21, 7])
def test_advantages_are_normalised_by_minibatch(count: int) -> None:
    values = torch.randn(count, generator=random_streams.generator(1, 'x')) * 3 + 5
    found = values.clone()
    Minibatches((values,), (), 10, 4).normalise_(found)
    for part, before in zip(found.split(10), values.split(10), strict=True):
        expected = (before - before.mean()) / (before.std() + 1e-8) if len(before) > 1 else before
        torch.testing.assert_close(part, expected)


def learner(device: str = 'cpu', world: str = 'rocket', **changes: Any) -> Learner:
    spec = worlds.make(world, num_envs=4).spec
    return Learner(spec, load_preset('default', world, **{
        'hidden_sizes': (16, 16), 'batch_size': 64, 'device': device, 'threads': 1,
        'critic_warmup_iterations': 0, 'start_copies': 1, 'n_epochs': 2, **changes}))


def batch(one: Learner) -> Batch:
    noise = random_streams.generator(1, 'n')
    observation = torch.randn(256, len(one.policy.normaliser.width), generator=noise)
    with torch.no_grad():
        action, log_prob = one.policy.sample(observation, noise)
        value = one.critic(observation)
    advantage, error = torch.randn(2, 256, generator=noise)
    return Batch(observation, action, log_prob, advantage, value + error, value)


@pytest.mark.parametrize('field', ['advantage', 'target'])
def test_an_update_that_diverges_is_reported(field: str) -> None:
    one = learner()
    samples = batch(one)
    poisoned = samples._replace(**{field: torch.full((256,), torch.inf)})
    network = {'advantage': 'policy', 'target': 'critic'}[field]
    refusal = f'iteration 99: the weights of the {network} are no longer'
    with pytest.raises(ValueError, match=refusal):
        one.improve(99, poisoned, lambda: None)


def improved(one: Learner, iterations: int = 2) -> dict[str, torch.Tensor]:
    samples = batch(one)
    for iteration in range(1, iterations + 1):
        one.improve(iteration, samples, lambda: None)
    return one.tensors()


@pytest.mark.parametrize('world', ['rocket', 'lunar_lander'])
def test_networks_on_another_device_are_copied_back(
    world: str, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """`cpu:0` is the same device as `cpu`, but torch distinguishes the two."""
    here = learner(world=world)
    expected = improved(here)
    monkeypatch.setattr(learner_module, 'find_device', lambda name: torch.device('cpu', 0))
    there = learner(world=world)
    found = improved(there)
    assert found.keys() == expected.keys()
    for name, tensor in expected.items():
        assert torch.equal(found[name], tensor), name
    # Changes of the networks here, by cloning or a checkpoint, count there.
    for one in (here, there):
        one.load(Path('x'), learner(world=world).tensors())
        one.policy.normaliser.mean += 0.5
        one.critic.normaliser.mean += 0.5
    expected, found = improved(here), improved(there)
    assert all(torch.equal(found[name], tensor) for name, tensor in expected.items())


@needs_gpu
@pytest.mark.parametrize('world', ['rocket', 'lunar_lander'])
def test_the_gpu_learns_the_same_but_for_rounding(world: str) -> None:
    expected, there = improved(learner(world=world)), learner('cuda', world)
    found = improved(there)
    assert all(tensor.device.type == 'cpu' for tensor in found.values())
    for name, tensor in expected.items():
        torch.testing.assert_close(found[name], tensor, rtol=1e-3, atol=1e-5)
    back = learner(world=world)
    back.load(Path('from the GPU'), found)
    for name, tensor in back.tensors().items():
        assert torch.equal(tensor, found[name])


@pytest.mark.parametrize(('copies', 'learns'), [
    (1, 'critic.value.0.weight'), (2, 'policy.mean.0.weight')])
def test_only_a_critic_that_learns_is_warmed_up(copies: int, learns: str) -> None:
    """With copies of a start it does not learn, and the policy learns from the beginning."""
    one = learner(start_copies=copies, critic_warmup_iterations=3)
    before = one.tensors()
    samples = batch(one)
    one.improve(1, samples, lambda: None)
    after = one.tensors()
    assert [name for name in ('policy.mean.0.weight', 'critic.value.0.weight')
            if not torch.equal(after[name], before[name])] == [learns]


def test_a_device_that_is_unknown_or_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, 'is_available', lambda: False)
    with pytest.raises(ValueError, match="device: got 'cuda', but torch finds no GPU"):
        learner('cuda')
    with pytest.raises(ValueError, match="device: got 'tpu', expected one of auto, cpu, cuda"):
        learner('tpu')


def test_a_run_may_continue_on_another_device() -> None:
    spec = worlds.make('rocket', num_envs=4).spec
    found, other = (
        json.loads(json.dumps(description(spec, load_preset('default', device=name))))
        for name in ('cpu', 'auto'))
    assert found['training']['device'] != other['training']['device']
    _same(Path('checkpoint'), found, other)


def test_a_loaded_learner_continues_bit_for_bit(tmp_path: Path) -> None:
    one, other = learner(), learner()
    saved = improved(one)
    assert int(saved['policy_optimiser.steps']) == 16
    other.load(Path('x'), saved)
    expected = improved(one)
    for name, tensor in improved(other).items():
        assert torch.equal(tensor, expected[name]), name
    assert not torch.equal(saved['critic.value.0.bias'], expected['critic.value.0.bias'])
    # Parameters share a piece of memory, of which a file holds what is the policy's.
    spec, path = worlds.make('rocket', num_envs=4).spec, tmp_path / 'policy.safetensors'
    config = load_preset('default', hidden_sizes=(16, 16))
    save_policy(path, one.policy, spec, config.network, 1, {})
    for name, tensor in load_policy(path, spec)[0].state_dict().items():
        assert torch.equal(tensor, expected[f'policy.{name}'])
    assert path.stat().st_size < 10_000


@pytest.mark.parametrize(('damage', 'message'), [
    ({'policy_optimiser.steps': None}, r'x: holds tensors .*expected .*policy_optimiser\.steps'),
    ({'critic_optimiser.0.exp_avg': torch.zeros(3)},
     r"x: tensor 'critic_optimiser\.0\.exp_avg' is .*\(3,\), expected .*\(16, 32\)"),
    ({'policy.log_std': torch.full((3,), torch.nan)}, r"x: tensor 'policy\.log_std' has a value"),
])
def test_tensors_that_do_not_fit_are_refused_and_change_nothing(
    damage: dict[str, Any], message: str,
) -> None:
    one = learner()
    before = one.tensors()
    broken = {name: tensor for name, tensor in {**improved(learner()), **damage}.items()
              if tensor is not None}
    with pytest.raises(ValueError, match=message):
        one.load(Path('x'), broken)
    assert all(torch.equal(tensor, before[name]) for name, tensor in one.tensors().items())


def test_equal_seeds_learn_the_same() -> None:
    first, again = improved(learner()), improved(learner())
    assert all(torch.equal(tensor, again[name]) for name, tensor in first.items())


def test_the_discount_goes_from_the_first_iterations_to_the_last_geometrically() -> None:
    """One less it: 0.01, 0.001, 0.0001; the same throughout where there is no first."""
    spec = worlds.make('rocket').spec
    rising = Learner(spec, load_preset('quick', gamma_first=0.99, gamma=0.9999, iterations=3))
    assert [1 - rising.gamma(k) for k in (1, 2, 3)] == pytest.approx([1e-2, 1e-3, 1e-4])
    assert Learner(spec, load_preset('quick', gamma=0.995)).gamma(7) == 0.995
    alone = Learner(spec, load_preset('quick', gamma_first=0.9, gamma=0.995, iterations=1))
    assert alone.gamma(1) == 0.995


def test_the_entropy_bonus_goes_from_the_first_iteration_to_the_end_linearly() -> None:
    """As the learning rates do: it would be there one iteration after the last."""
    spec = worlds.make('lunar_lander').spec

    def weights(**changes: float) -> list[float]:
        config = load_preset('quick', 'lunar_lander', iterations=4, **changes)
        return [Learner(spec, config).entropy_coefficient(k) for k in (1, 2, 3, 4)]

    assert weights(entropy_coefficient=0.01, entropy_coefficient_final=0.03) == pytest.approx(
        [0.01, 0.015, 0.02, 0.025])
    assert weights(entropy_coefficient=0.01, entropy_coefficient_final=0.0) == pytest.approx(
        [0.01, 0.0075, 0.005, 0.0025])
    assert weights(entropy_coefficient=0.01) == [0.01] * 4


def test_an_update_uses_the_entropy_bonus_of_its_iteration() -> None:
    def learnt(first: float, final: float) -> list[torch.Tensor]:
        one = learner(
            world='lunar_lander', iterations=2, entropy_coefficient=first,
            entropy_coefficient_final=final)
        one.improve(2, batch(one), lambda: None)
        return list(one.tensors().values())

    falling, half, whole = learnt(1.0, 0.0), learnt(0.5, -1.0), learnt(1.0, -1.0)
    assert all(map(torch.equal, falling, half))
    assert not all(map(torch.equal, falling, whole))


def test_hidden_observations_reach_the_critic_and_not_the_policy() -> None:
    one = learner(
        world='lunar_lander', symmetry='none',
        hidden_observations='left_contact angle of_no_world')
    names = worlds.make('lunar_lander').spec.observation_names
    observation = torch.zeros(len(names), len(names))
    observation.fill_diagonal_(1.0)
    nothing = torch.zeros(1, len(names))
    for network, hidden in ((one.policy.output, {'left_contact', 'angle'}), (one.critic, set())):
        with torch.no_grad():
            used = [
                name for name, row in zip(names, observation, strict=True)
                if not torch.equal(network(row[None]), network(nothing))]
        assert set(names) - set(used) == hidden


@pytest.mark.parametrize('text', [
    'left_contact angle', 'left_contact,angle', ' left_contact , angle,', 'angle,,left_contact'])
def test_names_of_observations_are_separated_by_spaces_or_commas(text: str) -> None:
    one = learner(
        world='lunar_lander', symmetry='none', hidden_observations=text, fine_observations=text)
    names = worlds.make('lunar_lander').spec.observation_names
    for chosen in (one.policy.normaliser.scale == 0, one.policy.normaliser.width > 0):
        assert {name for name, is_it in zip(names, chosen.tolist(), strict=True) if is_it} == {
            'left_contact', 'angle'}


@pytest.mark.parametrize('kind', ['descent', 'guidance'])
def test_an_observation_that_features_use_cannot_be_hidden(kind: str) -> None:
    with pytest.raises(ValueError, match=(
            "^hidden_observations: got 'up_y spin_x', expected no spin_x with features: "
            f"'{kind}', which are computed from it$")):
        learner(features=kind, hidden_observations='up_y spin_x')
    learner(features=kind, hidden_observations='up_y')
    learner(features='none', hidden_observations='up_y spin_x')


def test_a_saved_policy_keeps_its_hidden_observations(tmp_path: Path) -> None:
    one = learner(world='lunar_lander', symmetry='none', hidden_observations='left_contact')
    spec = worlds.make('lunar_lander', num_envs=4).spec
    config = load_preset('default', 'lunar_lander', symmetry='none', hidden_sizes=(16, 16))
    save_policy(tmp_path / 'policy', one.policy, spec, config.network, 1, {})
    found = load_policy(tmp_path / 'policy', spec)[0]
    assert torch.equal(found.normaliser.scale, one.policy.normaliser.scale)
    assert int((found.normaliser.scale == 0).sum()) == 1
