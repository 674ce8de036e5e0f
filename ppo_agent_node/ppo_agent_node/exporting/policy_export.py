# SPDX-License-Identifier: Apache-2.0
"""Export of a policy to an ONNX file, compared with PyTorch before it is written."""
from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ppo_agent_node.atomic_file import write_atomically
from ppo_agent_node.exporting import graph
from ppo_agent_node.exporting import provenance
from ppo_agent_node.exporting import units
from ppo_agent_node.pilots import onnx_file
from ppo_agent_node.pilots.policy import PolicyPilot
from ppo_agent_node.ppo.policies.factory import Policy
from ppo_agent_node.ppo.policies.file import POLICY
from ppo_agent_node.ppo.policies.file import load_policy
from ppo_agent_node.runs import tensor_file
from rocket_sim_node import worlds
from rocket_sim_node.gym.spaces import observation_bounds
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.base import F32

OBSERVATIONS = 10_000
"""Observations on which the graph is compared with PyTorch."""
TOLERANCE = 1e-5
"""Largest allowed difference of an action; for discrete actions, between the logit of the choice
and the largest one."""
_WIDE = 5.0
"""Bound of random observations for entries that the world does not bound."""
_FLOWN_ENVS, _FLOWN_EVERY = 100, 9


@dataclass(frozen=True)
class Exported:
    """An exported file and its comparison with PyTorch."""

    path: Path
    size: int
    """Bytes."""
    difference: float
    """Largest difference from PyTorch."""
    rounding: float
    """Largest difference of PyTorch's own float32 results from those in double precision."""
    observations: int
    """Number of observations compared."""


def export(path: Path, output: Path) -> Exported:
    """Write a policy as an ONNX file.

    :param path: a policy file.
    :raises ValueError: if the file is damaged, its world does not exist in this version, a package
        is missing, or the graph differs from PyTorch by more than the larger of 1e-5 and
        twice `rounding`; the message names file and reason.
    :raises OSError: if a file cannot be read or written.
    """
    content = tensor_file.read(path, POLICY).content
    spec = world_of(path, content)
    policy, content = load_policy(path, spec)
    try:
        model = graph.to_onnx(policy, spec)
    except ModuleNotFoundError as error:
        raise ValueError(
            f'{error.name} is not installed, expected the packages of the extra export: '
            "pip install './ppo_agent_node[export]'") from error
    observations = sample(path, spec)
    metadata = description(path, content, spec)
    # Compare the file as it will be written, except for the result of the comparison.
    try:
        difference, rounding = _compare(_sealed(model, metadata), policy, spec, observations)
    except ValueError as error:
        raise ValueError(f'{path}: {error}') from error
    metadata['check'] = {
        'observations': len(observations), 'greatest_difference': difference,
        'torch_rounding': rounding, 'torch': torch.__version__}
    allowed = max(TOLERANCE, 2 * rounding)
    if not difference <= allowed < math.inf:
        raise ValueError(
            f'{path}: the graph differs from PyTorch by {difference:.2g}, expected at most '
            f'{allowed:.2g}')
    data = _sealed(model, metadata)
    write_atomically(output, data)
    return Exported(output, len(data), difference, rounding, len(observations))


def world_of(path: Path, content: dict[str, Any]) -> WorldSpec:
    """Return the description of the world in which a policy was trained.

    :raises ValueError: if this version does not have that world.
    """
    name = content.get('world')
    settings = content.get('world_settings')
    if name not in worlds.names() or not isinstance(settings, dict):
        raise ValueError(
            f'{path}: world of the policy: got {name!r:.80}, expected one of '
            f'{", ".join(worlds.names())}')
    try:
        return worlds.make(name, 1, 0, **worlds.settings_from(name, settings)).spec
    except (TypeError, ValueError) as error:
        raise ValueError(f'{path}: world_settings: {error}') from error


def description(path: Path, content: dict[str, Any], spec: WorldSpec) -> dict[str, Any]:
    """Return the metadata of the file, which describes its policy."""
    low, high = observation_bounds(spec)
    seen, done = units.observation_units(spec), units.action_units(spec)
    return {
        **{name: content[name] for name in (
            'world', 'observation_names', 'action_names', 'continuous', 'action_count', 'seed',
            'training', 'world_settings')},
        'observation_units': [one.unit for one in seen],
        'observation_scales': [one.scale for one in seen],
        'observation_low': _finite(low), 'observation_high': _finite(high),
        'action_units': [one.unit for one in done],
        'action_choices': list(units.action_choices(spec)),
        'action_low': list(spec.action_low), 'action_high': list(spec.action_high),
        'dt': spec.dt, 'provenance': provenance.of(path, content),
    }


def _finite(values: F32) -> list[float | None]:
    """Return bounds in a form that JSON supports; None means no bound."""
    return [float(value) if np.isfinite(value) else None for value in values]


def sample(path: Path, spec: WorldSpec, count: int = OBSERVATIONS) -> F32:
    """Return observations `(count, D)`, half from the policy's flights, half drawn at random."""
    world = worlds.make(
        spec.name, _FLOWN_ENVS, 1, **worlds.settings_from(spec.name, spec.settings))
    pilot, seen = PolicyPilot(path, world.spec), []
    observation = world.reset()
    for step in range(count // 2 // _FLOWN_ENVS * _FLOWN_EVERY):
        if step % _FLOWN_EVERY == 0:
            seen.append(observation)
        observation = world.step(pilot(observation))[0]
    low, high = observation_bounds(spec)
    drawn = np.random.default_rng(1).uniform(
        np.maximum(low, -_WIDE), np.minimum(high, _WIDE),
        (count - count // 2, spec.observation_size))
    return np.concatenate((*seen, drawn.astype(np.float32)))


def _sealed(model: Any, metadata: dict[str, Any]) -> bytes:
    """Return the file of a model with its description."""
    model.ClearField('metadata_props')
    for key, value in onnx_file.metadata(metadata).items():
        model.metadata_props.add(key=key, value=value)
    return onnx_file.seal(model.SerializeToString(deterministic=True))


def _compare(
    data: bytes, policy: Policy, spec: WorldSpec, observations: F32,
) -> tuple[float, float]:
    """Return the largest difference of a file's actions from PyTorch's, and PyTorch's rounding.

    In a network with large weights, float32 results differ from those in double precision by more
    than 1e-5, although they are correct. For a single observation PyTorch uses other matrix
    kernels than for a batch, so both are compared. Two libraries that round by as much differ by
    up to twice that.
    """
    module = graph.DeterministicPolicy(policy, spec).eval()
    with torch.inference_mode():
        rows = torch.tensor(observations)
        output = module.output(rows)
        singly = torch.cat([module.output(row[None]) for row in rows])
        exact = copy.deepcopy(module).double().output(rows.double())
    found = torch.from_numpy(onnx_file.loaded(Path('export'), data, spec)[0](observations))
    rounding = float(torch.maximum((output - exact).abs(), (singly - exact).abs()).max())
    if spec.continuous:
        return float((found - output).abs().max()), rounding
    # If two choices have almost equal logits, either may be chosen, so compare the logits.
    chosen = output.gather(1, found[:, None])[:, 0]
    return float((output.amax(1) - chosen).max()), rounding
