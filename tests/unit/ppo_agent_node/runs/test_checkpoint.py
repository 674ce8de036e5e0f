# SPDX-License-Identifier: Apache-2.0
"""Tensor files: contents are read back unchanged, and damaged files are refused by name."""
from __future__ import annotations

import dataclasses
import errno
import os
import pickle
from pathlib import Path
from typing import Any

import pytest
import safetensors.torch
import torch
from support.training.line_world import LineWorld

from ppo_agent_node import random_streams
from ppo_agent_node.config.training_config import NetworkConfig
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.expert.expert import ExpertPilot
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.pilots.search import find_policy
from ppo_agent_node.ppo.policies.factory import GaussianPolicy
from ppo_agent_node.ppo.policies.factory import make_policy
from ppo_agent_node.ppo.policies.file import load_policy
from ppo_agent_node.ppo.policies.file import save_policy
from ppo_agent_node.runs import tensor_file
from rocket_sim_node import worlds

TENSORS = {
    'weight': torch.arange(6.0).reshape(2, 3), 'step': torch.tensor(7.0),
    'world': torch.tensor([1, 2, 255], dtype=torch.uint8),
    'half': torch.tensor([1.5], dtype=torch.bfloat16),
}
CONTENT = {'iteration': 3, 'best': None, 'settings': {'gamma': 0.99, 'name': 'ü'}}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / 'one.safetensors'
    tensor_file.write(file, 'checkpoint', TENSORS, CONTENT)
    return file


def test_contents_are_read_back_unchanged(path: Path) -> None:
    tensors, content = tensor_file.read(path, 'checkpoint')
    assert content == CONTENT
    assert set(tensors) == set(TENSORS)
    for name, tensor in TENSORS.items():
        assert torch.equal(tensors[name], tensor)
        assert tensors[name].dtype == tensor.dtype
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_any_reader_of_safetensors_can_open_it(path: Path) -> None:
    with safetensors.safe_open(path, 'pt') as file:
        assert file.metadata()['hoverslam'] == 'checkpoint'
        assert torch.equal(file.get_tensor('weight'), TENSORS['weight'])


@pytest.mark.parametrize('keep', [0, 5, 8, 40, 0.5, -1])
def test_truncated(path: Path, keep: float) -> None:
    data = path.read_bytes()
    path.write_bytes(data[:int(keep * len(data)) if isinstance(keep, float) else keep])
    with pytest.raises(ValueError, match=r'one\.safetensors: damaged'):
        tensor_file.read(path, 'checkpoint')


def test_every_flipped_byte_is_noticed(path: Path) -> None:
    data = path.read_bytes()
    for place in range(0, len(data), 7):
        path.write_bytes(data[:place] + bytes([data[place] ^ 0x10]) + data[place + 1:])
        with pytest.raises(ValueError, match=r'one\.safetensors'):
            tensor_file.read(path, 'checkpoint')


def test_foreign_files(tmp_path: Path) -> None:
    path = tmp_path / 'foreign.bin'
    safetensors.torch.save_file({'a': torch.zeros(2)}, path)
    with pytest.raises(ValueError, match=r"foreign\.bin: holds 'something foreign', expected"):
        tensor_file.read(path, 'checkpoint')
    headers = (b'\x08' + b'\0' * 7 + b'[]      ', b'\x02' + b'\0' * 7 + b'{}')
    for data in (b'hello, world, this is no such file', os.urandom(300), *headers):
        path.write_bytes(data)
        with pytest.raises(ValueError, match=r'foreign\.bin'):
            tensor_file.read(path, 'checkpoint')


def test_another_kind_or_version_is_refused(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="holds 'checkpoint', expected 'policy'"):
        tensor_file.read(path, 'policy')
    monkeypatch.setattr(tensor_file, 'FORMAT_VERSION', '2')
    with pytest.raises(ValueError, match="format version '1', expected '2'"):
        tensor_file.read(path, 'checkpoint')


def test_reading_executes_nothing(tmp_path: Path) -> None:
    class Bomb:
        def __reduce__(self) -> Any:
            return os.mkdir, (str(tmp_path / 'boom'),)

    path = tmp_path / 'bomb.safetensors'
    path.write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(ValueError, match='bomb'):
        tensor_file.read(path, 'checkpoint')
    torch.save({'x': Bomb()}, path)
    with pytest.raises(ValueError, match='bomb'):
        tensor_file.read(path, 'checkpoint')
    assert not (tmp_path / 'boom').exists()


def test_a_failed_write_leaves_the_old_file_and_no_rubbish(
    path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, 'No space left on device')

    before = path.read_bytes()
    monkeypatch.setattr(os, 'fsync', full)
    with pytest.raises(OSError, match=r'No space left on device.*one\.safetensors') as caught:
        tensor_file.write(path, 'checkpoint', {}, {})
    assert caught.value.errno == errno.ENOSPC
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def policy(path: Path, **change: Any) -> GaussianPolicy:
    made = GaussianPolicy(15, 3, (8, 4), random_streams.generator(1, 'policy'))
    spec = dataclasses.replace(worlds.make('rocket').spec, **change)
    save_policy(path, made, spec, NetworkConfig(hidden_sizes=(8, 4)), 1, {'mean_return': 290.5})
    return made


def test_a_saved_policy_gives_the_same_actions(tmp_path: Path) -> None:
    path = tmp_path / 'policy.safetensors'
    made = policy(path)
    world = worlds.make('rocket', num_envs=5, seed=2)
    pilot = PolicyPilot(path, world.spec)
    observation = world.reset()
    action = pilot(observation)
    assert action.shape == (5, 3)
    assert action.dtype == 'float32'
    assert torch.equal(torch.from_numpy(action), made.mode(torch.from_numpy(observation)).detach())
    assert (pilot(observation) == action).all()
    assert pilot.description['training'] == {'mean_return': 290.5}
    assert pilot.description['world'] == 'rocket'


def test_another_vehicle_than_in_training_is_reported(tmp_path: Path) -> None:
    """Other starts of episodes are not reported, as a curriculum changes them."""
    path = tmp_path / 'policy.safetensors'
    policy(path)
    assert not PolicyPilot(path, worlds.make('rocket', level=3, spawn_speed=1.0).spec).unfamiliar
    heavy = PolicyPilot(path, worlds.make('rocket', dry_mass=20_000.0, level=3).spec)
    assert heavy.unfamiliar == f'{path} was trained with dry_mass 22000.0, here 20000'
    assert not PolicyPilot(path, worlds.make('rocket_planar').spec).unfamiliar


def test_activations_are_kept_and_those_of_old_files_are_tanh(tmp_path: Path) -> None:
    spec, observation = worlds.make('rocket').spec, torch.randn(6, 15)
    path, network = tmp_path / 'one.safetensors', NetworkConfig((8, 4), 'relu')
    made = make_policy(spec, network, random_streams.generator(1, 'policy'))
    save_policy(path, made, spec, network, 1, {})
    loaded, content = load_policy(path, spec)
    assert content['activation'] == 'relu'
    assert torch.equal(loaded.mode(observation), made.mode(observation))
    tensors, content = tensor_file.read(path, 'policy')
    del content['activation']
    tensor_file.write(path, 'policy', tensors, content)
    tanh = make_policy(spec, NetworkConfig((8, 4)), random_streams.generator(1, 'policy'))
    old = load_policy(path, spec)[0].mode(observation)
    assert torch.equal(old, tanh.mode(observation))
    assert not torch.equal(old, made.mode(observation))
    for wrong in ('gelu', 5):
        tensor_file.write(path, 'policy', tensors, {**content, 'activation': wrong})
        with pytest.raises(ValueError, match=r'one\.safetensors: activation: got'):
            load_policy(path, spec)


def test_the_policy_that_ships_lands(tmp_path: Path) -> None:
    world = worlds.make('rocket', num_envs=8)
    pilot = PolicyPilot(find_policy('', 'rocket', tmp_path), world.spec)
    assert int(evaluate(world, pilot, 8, 1, level=7).landed.sum()) == 8


def test_a_policy_flies_any_world_of_the_same_observations_and_actions(tmp_path: Path) -> None:
    path = tmp_path / 'policy.safetensors'
    made = policy(path)
    planar = 'rocket_planar'
    spec = worlds.make(planar).spec if planar in worlds.names() else dataclasses.replace(
        worlds.make('rocket').spec, name=planar)
    loaded, content = load_policy(path, spec)
    assert content['world'] == 'rocket'
    observation = torch.randn(3, 15)
    assert torch.equal(loaded.mode(observation), made.mode(observation))
    assert ExpertPilot(spec)(observation.numpy()).shape == (3, 3)
    with pytest.raises(ValueError, match=r"world 'rocket'.*world 'line'"):
        load_policy(path, LineWorld().spec)


def test_discrete_policies(tmp_path: Path) -> None:
    path, spec = tmp_path / 'policy.safetensors', LineWorld().spec
    network = NetworkConfig((8,))
    made = make_policy(spec, network, random_streams.generator(1, 'policy'))
    save_policy(path, made, spec, network, 1, {})
    observation = torch.randn(20, 2)
    assert torch.equal(load_policy(path, spec)[0].mode(observation), made.mode(observation))
    with pytest.raises(ValueError, match=r'action_count.* got 4 .*expected 5 '):
        load_policy(path, dataclasses.replace(spec, action_count=5))
    tensors, content = tensor_file.read(path, 'policy')
    tensors['logits.0.bias'][1] = float('nan')
    tensor_file.write(path, 'policy', tensors, content)
    with pytest.raises(ValueError, match=r"'logits\.0\.bias' has a value that is not finite"):
        load_policy(path, spec)


def test_policies_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    path, spec = tmp_path / 'policy.safetensors', worlds.make('rocket').spec
    with pytest.raises(FileNotFoundError):
        load_policy(path, spec)
    policy(path, observation_names=('height',))
    with pytest.raises(ValueError, match=r'policy\.safetensors: observation_names.*height'):
        load_policy(path, spec)
    policy(path, action_names=('left', 'right', 'up'))
    with pytest.raises(ValueError, match=r"action_names.*'left'"):
        load_policy(path, spec)
    tensors, content = _contents(path, policy(path))
    tensor_file.write(path, 'policy', tensors, {**content, 'hidden_sizes': [8, 5]})
    with pytest.raises(ValueError, match=r'of shape \(4, 8\), expected .* \(5, 8\)'):
        load_policy(path, spec)
    tensor_file.write(path, 'policy', tensors, {**content, 'hidden_sizes': 'many'})
    with pytest.raises(ValueError, match='hidden_sizes'):
        load_policy(path, spec)
    tensors['log_std'][1] = float('nan')
    tensor_file.write(path, 'policy', tensors, content)
    with pytest.raises(ValueError, match="tensor 'log_std' has a value that is not finite"):
        load_policy(path, spec)
    del tensors['log_std']
    tensor_file.write(path, 'policy', tensors, content)
    with pytest.raises(ValueError, match='holds tensors'):
        load_policy(path, spec)


def _contents(path: Path, made: GaussianPolicy) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    content = tensor_file.read(path, 'policy').content
    return {name: tensor.clone() for name, tensor in made.state_dict().items()}, content


@pytest.mark.parametrize('name', [
    'observation_names', 'action_names', 'continuous', 'action_count', 'hidden_sizes'])
def test_a_policy_without_a_required_entry_is_refused(tmp_path: Path, name: str) -> None:
    spec, path = worlds.make('rocket').spec, tmp_path / 'policy.safetensors'
    network = NetworkConfig(hidden_sizes=(4,))
    policy = make_policy(spec, network, torch.Generator())
    save_policy(path, policy, spec, network, 1, {})
    tensors, found = tensor_file.read(path, 'policy')
    del found[name]
    tensor_file.write(path, 'policy', tensors, found)
    with pytest.raises(ValueError, match=(
            rf'policy\.safetensors: the policy has no {name}, expected observation_')):
        load_policy(path, spec)
