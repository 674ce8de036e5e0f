# SPDX-License-Identifier: Apache-2.0
"""Policies as ONNX files: their format, and flying them by onnxruntime, without PyTorch.

An ONNX file (onnx.ai) has a graph and string metadata. Here the graph is the whole way from an
observation in the world's own units to the action: features, normaliser, network, most likely
action. The metadata have the description of the policy, one JSON value an entry, and a SHA-256
digest over the file, which is written into the file with 64 zeros in its place.
"""
from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppo_agent_node.ppo.policies.compatibility import fitted
from rocket_sim_node import input_file
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.base import F32

SUFFIX = '.onnx'
FORMAT_VERSION = 1
INPUT, OUTPUT = 'observation', 'action'
_LARGEST = 2**30
"""Maximum bytes of a file."""
_OPEN = b'sha256:' + 64 * b'0'
_SEALED = re.compile(rb'sha256:([0-9a-f]{64})')
_ELEMENTS = {True: 'tensor(float)', False: 'tensor(int64)'}
"""Types of an action, by whether it is continuous."""
Fly = Callable[[F32], NDArray[Any]]


def metadata(description: Mapping[str, Any]) -> dict[str, str]:
    """Return the metadata entries of a file that is not sealed yet."""
    return {
        'hoverslam': 'policy', 'version': str(FORMAT_VERSION),
        **{name: json.dumps(value) for name, value in description.items()},
        'digest': _OPEN.decode()}


def seal(data: bytes) -> bytes:
    """Return a file with its digest written into its metadata.

    :raises ValueError: when the place for it is not there exactly once.
    """
    if data.count(_OPEN) != 1:
        raise ValueError(f'digest: got {data.count(_OPEN)} places for it, expected one')
    digest = hashlib.sha256(data).hexdigest().encode()
    return data.replace(_OPEN, b'sha256:' + digest)


def load(path: Path, spec: WorldSpec) -> tuple[Fly, dict[str, Any]]:
    """Return a deterministic pilot, in NumPy, for a world that the policy fits; its description.

    :raises FileNotFoundError: when there is no such file.
    :raises ValueError: when it is damaged, foreign or does not fit, or onnxruntime is missing.
    """
    return loaded(path, input_file.read_bytes(path, _LARGEST), spec)


def loaded(path: Path, data: bytes, spec: WorldSpec) -> tuple[Fly, dict[str, Any]]:
    """Return what `load` does, of a file's content.

    :param path: for the messages of errors.
    :raises ValueError: as `load` does.
    """
    _verify(path, data)
    session = _session(path, data)
    description = _description(path, session)
    world = fitted(path, description, spec)
    _check_graph(path, session, world)

    def fly(observation: F32) -> NDArray[Any]:
        action: NDArray[Any] = session.run([OUTPUT], {INPUT: observation})[0]
        if not world.continuous and (bad := np.flatnonzero(action < 0)).size:
            raise ValueError(f'policy: the probabilities of row {bad[0]} are not finite')
        return action

    return fly, description


def _verify(path: Path, data: bytes) -> None:
    """Check the digest.

    :raises ValueError: when the file is damaged or foreign.
    """
    found = _SEALED.findall(data)
    if len(found) != 1:
        raise ValueError(
            f'{path}: holds no complete policy, expected a file written by '
            './launch_scripts/export')
    digest = hashlib.sha256(_SEALED.sub(_OPEN, data)).hexdigest()
    if digest != found[0].decode():
        raise ValueError(
            f'{path}: damaged, its content has digest {digest[:12]}, '
            f'expected {found[0].decode()[:12]}')


def _session(path: Path, data: bytes) -> Any:
    """Return the session that computes the graph, by one thread, as the networks are small.

    :raises ValueError: when there is no onnxruntime, or it refuses the graph.
    """
    try:
        import onnxruntime
    except ModuleNotFoundError as error:
        raise ValueError(
            f'{path}: needs onnxruntime, which is not installed: pip install onnxruntime'
        ) from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3  # its warnings are for authors of graphs
    try:
        return onnxruntime.InferenceSession(data, options, providers=['CPUExecutionProvider'])
    except Exception as error:  # its errors have no base of their own
        raise ValueError(f'{path}: refused by onnxruntime: {error!s:.200}') from error


def _description(path: Path, session: Any) -> dict[str, Any]:
    """Return the description of the policy.

    :raises ValueError: when it is of another version or damaged.
    """
    entries = dict(session.get_modelmeta().custom_metadata_map)
    for name, expected in (('hoverslam', 'policy'), ('version', str(FORMAT_VERSION))):
        if (found := entries.pop(name, None)) != expected:
            raise ValueError(f'{path}: {name}: got {found!r:.40}, expected {expected!r}')
    entries.pop('digest', '')
    try:
        return {name: json.loads(text) for name, text in entries.items()}
    except ValueError as error:
        raise ValueError(f'{path}: damaged, its metadata is not JSON: {error}') from error


def _check_graph(path: Path, session: Any, spec: WorldSpec) -> None:
    """Check that the graph takes observations and returns actions of a world.

    :raises ValueError: when it does not.
    """
    given, found = session.get_inputs(), session.get_outputs()
    names = [one.name for one in given], [one.name for one in found]
    if names != ([INPUT], [OUTPUT]):
        raise ValueError(f'{path}: its graph has {names!s:.200}, expected {INPUT} and {OUTPUT}')
    kinds = [(one.type, list(one.shape[1:])) for one in (given[0], found[0])]
    action = [spec.action_size] if spec.continuous else []
    expected = [
        ('tensor(float)', [spec.observation_size]), (_ELEMENTS[spec.continuous], action)]
    if kinds != expected:
        raise ValueError(f'{path}: its graph has {kinds!s:.200}, expected {expected}')
