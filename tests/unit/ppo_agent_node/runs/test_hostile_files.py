# SPDX-License-Identifier: Apache-2.0
"""Damaged, truncated, foreign and malicious files are named and never executed."""
from __future__ import annotations

import json
import math
import os
import pickle
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from support.invalid_data.fuzzing import archive
from support.invalid_data.fuzzing import damage
from hypothesis import assume
from hypothesis import given
from hypothesis import strategies as st

from ppo_agent_node import random_streams
from ppo_agent_node.config.training_config import Config
from ppo_agent_node.config.training_config import NetworkConfig
from ppo_agent_node.evaluation import episode_table
from ppo_agent_node.ppo.policies.factory import make_policy
from ppo_agent_node.ppo.policies.file import load_policy
from ppo_agent_node.ppo.policies.file import save_policy
from ppo_agent_node.reporting import run_files
from ppo_agent_node.runs import tensor_file
from ppo_agent_node.runs.config_file import read_config
from ppo_agent_node.runs.train_log import read_log
from ppo_agent_node.training.curriculum import Curriculum
from ppo_agent_node.training.reverse_curriculum import ReverseCurriculum
from ppo_agent_node.training.run_state import RunState
from ppo_agent_node.training.run_state import content
from ppo_agent_node.training.run_state import from_content
from rocket_sim_node import worlds

SPEC = worlds.make('rocket', num_envs=2).spec
SMALL = NetworkConfig(hidden_sizes=(4,))
_MOST = 60e6
"""bytes that reading any of these small files may take"""
FIGURES = {
    'world': 'rocket', 'episodes': 1, 'landed': 1, 'landing_rate': 1.0,
    'landing_rate_interval': [0.5, 1.0], 'mean_return': 2.0, 'mean_return_interval': [1.0, 3.0],
    'outcomes': {'landed': 1}}
ROW = {column.name: '1' for column in episode_table.COLUMNS} | {
    'outcome': 'landed', 'after_touchdown': ''}


class Bomb:
    """Code that a pickle would execute."""

    def __init__(self, sentinel: Path) -> None:
        self.sentinel = sentinel

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.sentinel),)


def write_policy(path: Path) -> None:
    """Write a good policy."""
    policy = make_policy(SPEC, SMALL, random_streams.generator(1, 'policy'))
    save_policy(path, policy, SPEC, SMALL, 1, {})


def begun(config: Config) -> RunState:
    """Return the state of a run after three iterations."""
    return RunState(
        Curriculum.begin(config.curriculum), ReverseCurriculum.begin(config.curriculum, SPEC),
        iteration=3)


def write_checkpoint(path: Path) -> None:
    """Write a good checkpoint."""
    config = Config()
    state = begun(config)
    tensor_file.write(path, 'checkpoint', {'x': torch.arange(5.0)}, content(state, SPEC, config))


def write_config(path: Path) -> None:
    """Write good settings."""
    path.write_text(yaml.safe_dump({'world': 'rocket', 'training': {'gamma': 0.99}}))


def write_log(path: Path) -> None:
    """Write a good log."""
    path.write_text('{"stage": "finetune", "loss": 0.5}\n' * 3)


def write_figures(path: Path) -> None:
    """Write good figures of an evaluation."""
    path.write_text(json.dumps(FIGURES))


def write_episodes(path: Path) -> None:
    """Write a good table of episodes."""
    path.write_text(','.join(ROW) + '\n' + ','.join(ROW.values()) + '\n')


def read_checkpoint(path: Path) -> Any:
    """Read a checkpoint as a run that is resumed does."""
    saved = tensor_file.read(path, 'checkpoint')
    return from_content(path, saved, SPEC, Config()), saved.tensors['x'].tolist()


def read_policy(path: Path) -> Any:
    """Read a policy as a pilot does."""
    policy, found = load_policy(path, SPEC)
    return {name: tensor.tolist() for name, tensor in policy.state_dict().items()}, found


def read_table(path: Path) -> Any:
    """Read episodes; those that are not numbers are equal."""
    table = episode_table.read(path)
    return {name: values.tolist() for name, values in table.numbers.items()}, table.words


FILES: dict[str, tuple[Callable[[Path], None], Callable[[Path], Any]]] = {
    'policy.safetensors': (write_policy, read_policy),
    'iteration_000003.safetensors': (write_checkpoint, read_checkpoint),
    'config.yaml': (write_config, read_config),
    'train.jsonl': (write_log, read_log),
    'evaluation.json': (write_figures, run_files._figures),
    'episodes.csv': (write_episodes, read_table),
}
SEALED = [name for name in FILES if name.endswith('.safetensors')]


def read_or_refusal(path: Path, sentinel: Path, measured: bool = True) -> Any:
    """Return what a reader makes of a file; it names the file, or loads it, and that is all.

    :param measured: whether to look at the memory it takes, which takes long.
    """
    if measured:
        tracemalloc.start()
    try:
        return FILES[path.name][1](path)
    except ValueError as error:
        assert str(path) in str(error), error
        assert len(str(error)) < 3000
        return None
    finally:
        if measured:
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            assert peak < _MOST
        assert not sentinel.exists(), 'something was executed'


@pytest.fixture(autouse=True)
def _no_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files are not seen onto the disk here: there are thousands."""
    monkeypatch.setattr(os, 'fsync', lambda descriptor: None)


@pytest.mark.parametrize('name', FILES)
def test_damaged_files_are_refused_by_name(tmp_path: Path, name: str) -> None:
    """A tensor file is never taken for one of another kind."""
    path = tmp_path / name
    FILES[name][0](path)
    good, whole = path.read_bytes(), FILES[name][1](path)

    @given(st.one_of(damage(good), st.binary(max_size=300)))
    def check(bad: bytes) -> None:
        assume(bad != good)
        path.write_bytes(bad)
        taken = read_or_refusal(path, tmp_path / 'boom', measured=False)
        if name in SEALED and taken is not None:
            assert taken == whole

    check()


@pytest.mark.parametrize('name', SEALED)
def test_cut_short_anywhere(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    FILES[name][0](path)
    data = path.read_bytes()
    for length in range(0, len(data), max(len(data) // 300, 1)):
        path.write_bytes(data[:length])
        with pytest.raises(ValueError, match='damaged'):
            FILES[name][1](path)


def header_file(header: object, data: bytes = b'') -> bytes:
    """Return a safetensors file with any header."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack('<Q', len(text)) + text + data


def torch_file(sentinel: Path) -> bytes:
    """Return what `torch.save` makes of a bomb."""
    path = sentinel.with_name('bomb.pt')
    torch.save({'x': Bomb(sentinel)}, path)
    return path.read_bytes()


def laughs(depth: int = 40) -> bytes:
    """Return ten to the power of `depth` laughs, in a few bytes of YAML."""
    lines = ['a0: &a0 [ha, ha, ha, ha, ha, ha, ha, ha, ha, ha]']
    lines += [f'a{k}: &a{k} [{", ".join([f"*a{k - 1}"] * 10)}]' for k in range(1, depth)]
    return '\n'.join(lines).encode()


def merges(depth: int = 40) -> bytes:
    """Return as many merged mappings."""
    lines = ['a0: &a0 {x: 1}']
    lines += [f'a{k}: &a{k} {{<<: [{", ".join([f"*a{k - 1}"] * 10)}]}}' for k in range(1, depth)]
    return '\n'.join(lines).encode()


SEAL = {'hoverslam': 'policy', 'version': '1', 'content': '{}', 'digest': ''}
HOSTILE: dict[str, Callable[[Path], bytes]] = {
    'a pickle': lambda boom: pickle.dumps(Bomb(boom)),
    'a pickle of protocol 0': lambda boom: pickle.dumps(Bomb(boom), 0),
    'a file of torch': torch_file,
    'a zip archive': lambda boom: archive([('data.pkl', pickle.dumps(Bomb(boom)))]),
    'an empty file': lambda boom: b'',
    'noise': lambda boom: np.random.default_rng(1).bytes(5000),
    'zeros': lambda boom: bytes(5000),
    'an executable': lambda boom: b'#!/bin/sh\nmkdir ' + str(boom).encode() + b'\n',
    'object tags': lambda boom: f'!!python/object/apply:os.mkdir ["{boom}"]'.encode(),
    'a new object': lambda boom: f'a: !!python/object/new:os.mkdir ["{boom}"]'.encode(),
    'a module': lambda boom: b'a: !!python/module:antigravity',
    'laughs': lambda boom: laughs(),
    'merged laughs': lambda boom: merges(),
    'an endless loop': lambda boom: b'a: &a [*a]',
    'deep lists': lambda boom: b'[' * 10_000,
    'deep lists of JSON': lambda boom: b'{"stage": ' + b'[' * 10_000 + b']' * 10_000 + b'}\n',
    'deep mappings': lambda boom: b'{"a":' * 10_000,
    'large rubbish': lambda boom: b'[' * 1_000_000,
    'a long number': lambda boom: b'{"stage": ' + b'9' * 10_000 + b'}\n',
    'a date of no month': lambda boom: b'a: 2001-99-99',
    'a long header': lambda boom: struct.pack('<Q', 2**63) + b'{}',
    'a deep header': lambda boom: header_file(b'[' * 100_000),
    'an endless tensor': lambda boom: header_file({
        '__metadata__': SEAL, 'x': {
            'dtype': 'F32', 'shape': [2**40, 2**40], 'data_offsets': [0, 2**62]}}),
    'a wide tensor of nothing': lambda boom: header_file({
        '__metadata__': SEAL, 'x': {'dtype': 'F32', 'shape': [2**62, 0],
                                    'data_offsets': [0, 0]}}),
    'negative offsets': lambda boom: header_file({
        '__metadata__': SEAL, 'x': {'dtype': 'F32', 'shape': [1], 'data_offsets': [-4, 0]}}),
    'tensors that overlap': lambda boom: header_file({
        '__metadata__': SEAL, **{name: {'dtype': 'F32', 'shape': [1], 'data_offsets': [0, 4]}
                                 for name in 'xy'}}, bytes(4)),
    'an unknown kind': lambda boom: header_file({
        '__metadata__': SEAL, 'x': {'dtype': 'Q7', 'shape': [1], 'data_offsets': [0, 4]}},
        bytes(4)),
    'metadata of numbers': lambda boom: header_file({
        '__metadata__': {**SEAL, 'content': 5}}),
    'deep content': lambda boom: header_file({
        '__metadata__': {**SEAL, 'content': '[' * 100_000}}),
    'a table of nothing': lambda boom: b',' * 100_000 + b'\n' + b'1,' * 100_000,
    'an open quote': lambda boom: b'"' + b'x' * 500_000,
}


@pytest.mark.parametrize('name', FILES)
@pytest.mark.parametrize('what', HOSTILE)
def test_hostile_files_are_refused_by_name_and_execute_nothing(
        tmp_path: Path, name: str, what: str) -> None:
    path, boom = tmp_path / name, tmp_path / 'boom'
    path.write_bytes(HOSTILE[what](boom))
    # To trace a parser in deep recursion takes minutes, and it ends at the limit of that.
    taken = read_or_refusal(path, boom, measured='deep' not in what)
    if name in SEALED:
        assert taken is None


@pytest.mark.parametrize('sizes', [
    [16_384] * 40, [1] * 100_000, [10**400], [0], [-1], 'many', None, {'a': 1}, [[4]], [4.5],
], ids=lambda sizes: f'{sizes!r:.30}')
def test_a_policy_of_forged_size_is_refused_before_it_is_made(
        tmp_path: Path, sizes: Any) -> None:
    """Its digest is correct, as anyone can compute it."""
    path = tmp_path / 'policy.safetensors'
    write_policy(path)
    tensors, found = tensor_file.read(path, 'policy')
    tensor_file.write(path, 'policy', tensors, {**found, 'hidden_sizes': sizes})
    assert read_or_refusal(path, tmp_path / 'boom') is None


SCALAR = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5))
BEST = st.fixed_dictionaries({
    'iteration': SCALAR, 'episodes': st.one_of(st.integers(-1, 20), SCALAR),
    'landed': st.one_of(st.integers(-1, 20), SCALAR),
    'mean_return': st.one_of(st.just(1.0), SCALAR)})


@given(
    st.one_of(SCALAR, st.lists(SCALAR, max_size=3),
              st.dictionaries(st.text(max_size=5), SCALAR, max_size=3), BEST),
    st.sampled_from([None, 'iteration', 'steps', 'episodes', 'lines', 'level', 'recent', 'best',
                     'reach', 'recent_hardest', 'reset_iteration', 'description']))
def test_a_checkpoint_of_any_content_is_a_state_or_refused(
        tmp_path: Path, value: Any, name: str | None) -> None:
    path, config = tmp_path / 'iteration_000003.safetensors', Config()
    good = content(begun(config), SPEC, config)
    tensor_file.write(
        path, 'checkpoint', {'x': torch.zeros(5)}, value if name is None else {
            **good, name: value})
    taken = read_or_refusal(path, tmp_path / 'boom', measured=False)
    if taken is not None:
        state = taken[0]
        assert all(isinstance(number, int) and number >= 0 for number in (
            state.iteration, state.steps, state.episodes, state.lines, state.curriculum.level,
            state.reset_iteration))
        assert state.curriculum.level <= config.curriculum.curriculum_final_level
        assert state.reverse.over
        if state.best is not None:
            assert 0 <= state.best.landing_rate <= 1
            assert math.isfinite(state.best.mean_return)


def test_no_more_is_read_of_a_foreign_file_than_its_header(tmp_path: Path) -> None:
    path = tmp_path / 'policy.safetensors'
    with path.open('wb') as file:
        file.truncate(2**40)  # a hole: it takes no room on the disk
    with pytest.raises(ValueError, match=r'policy\.safetensors: got 1099511627776 bytes'):
        load_policy(path, SPEC)
    settings = tmp_path / 'config.yaml'
    with settings.open('wb') as file:
        file.truncate(2**40)
    with pytest.raises(ValueError, match=r'config\.yaml: got 1099511627776 bytes'):
        read_config(settings)
    os.mkfifo(tmp_path / 'pipe.safetensors')
    for other in (tmp_path, tmp_path / 'pipe.safetensors'):
        with pytest.raises(ValueError, match='expected a regular file'):
            load_policy(other, SPEC)
