# SPDX-License-Identifier: Apache-2.0
"""File format of checkpoints and policies: safetensors with a verified description.

The tensors are in a safetensors file (github.com/huggingface/safetensors), whose string metadata
has the kind of file, the version of the format, a JSON `content` and a SHA-256 digest over content
and tensors. Reading verifies all of it and executes nothing. Writing is atomic: a reader finds the
old file or the new one, whatever fails in between.
"""
from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from typing import NamedTuple

import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor

from ppo_agent_node.atomic_file import write_atomically
from rocket_sim_node import input_file

FORMAT_VERSION = '1'
_LARGEST = 4 * 2**30
"""Maximum bytes of a file; a checkpoint of the largest networks takes a quarter of it."""
_LARGEST_HEADER = 100_000_000
"""Bytes; also the limit of the safetensors library."""
_UNREADABLE = (
    SafetensorError, ValueError, KeyError, TypeError, RuntimeError, OverflowError, MemoryError)
"""Errors of safetensors, torch and json for damaged or forged files, including RecursionError."""
Tensors = dict[str, Tensor]


class TensorFile(NamedTuple):
    """Content of a file."""

    tensors: Tensors
    content: dict[str, Any]


def write(path: Path, kind: str, tensors: Mapping[str, Tensor], content: object) -> None:
    """Write a tensor file atomically.

    :param kind: kind of content; reading requires the same.
    :param content: JSON-serialisable.
    :raises OSError: naming the path.
    """
    text = json.dumps(content, sort_keys=True)
    plain = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    write_atomically(path, safetensors.torch.save(plain, metadata={
        'hoverslam': kind, 'version': FORMAT_VERSION, 'content': text,
        'digest': _digest(kind, text, plain),
    }))


def read(path: Path, kind: str) -> TensorFile:
    """Read and verify a tensor file.

    :raises FileNotFoundError: when there is none.
    :raises ValueError: when it is damaged, foreign, of another kind or version; the message
        names the file, and the actual and expected values.
    """
    metadata = _metadata(path)
    found = metadata.get('hoverslam')
    if found != kind:
        raise ValueError(f'{path}: holds {found or "something foreign"!r}, expected {kind!r}')
    if metadata.get('version') != FORMAT_VERSION:
        raise ValueError(
            f'{path}: format version {metadata.get("version")!r}, expected {FORMAT_VERSION!r}')
    data = input_file.read_bytes(path, _LARGEST)
    try:
        tensors = safetensors.torch.load(data)
        text = metadata['content']
        content = json.loads(text)
    except _UNREADABLE as error:
        raise ValueError(f'{path}: damaged, {len(data)} bytes: {error}') from error
    if not isinstance(content, dict):
        raise ValueError(f'{path}: damaged, its content is not a JSON object')
    digest = _digest(kind, text, tensors)
    if metadata.get('digest') != digest:
        raise ValueError(
            f'{path}: damaged, its content has digest {digest[:12]}, '
            f'expected {str(metadata.get("digest"))[:12]}')
    return TensorFile(tensors, content)


def _metadata(path: Path) -> dict[str, str]:
    """Return the string metadata: a JSON header after its length, 8 bytes little-endian.

    Nothing else is read, as a foreign file may be larger than the memory.
    """
    input_file.check(path, _LARGEST)
    with path.open('rb') as file:
        length = os.fstat(file.fileno()).st_size
        if length < 8:
            raise ValueError(f'{path}: damaged, only {length} bytes')
        size = int.from_bytes(file.read(8), 'little')
        if size > min(length - 8, _LARGEST_HEADER):
            raise ValueError(
                f'{path}: damaged, {length} bytes, expected a safetensors file of at least '
                f'{size + 8}, with a header of at most {_LARGEST_HEADER}')
        text = file.read(size)
    try:
        return dict(json.loads(text).get('__metadata__', {}))
    except (ValueError, AttributeError, TypeError, RecursionError) as error:
        raise ValueError(f'{path}: damaged, its header is not JSON: {error}') from error


def _digest(kind: str, content: str, tensors: Mapping[str, Tensor]) -> str:
    digest = hashlib.sha256(f'{kind}\n{FORMAT_VERSION}\n{content}\n'.encode())
    for name in sorted(tensors):
        tensor = tensors[name]
        digest.update(f'{name} {tensor.dtype} {tuple(tensor.shape)}\n'.encode())
        digest.update(tensor.reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def expect_tensors(path: Path, tensors: Tensors, expected: Mapping[str, Tensor]) -> None:
    """Check names, shapes and types of tensors against those expected.

    :raises ValueError: naming the file, and the actual and expected values.
    """
    if set(tensors) != set(expected):
        raise ValueError(
            f'{path}: holds tensors {sorted(tensors)}, expected {sorted(expected)}')
    for name, like in expected.items():
        found = tensors[name]
        if found.shape != like.shape or found.dtype != like.dtype:
            raise ValueError(
                f'{path}: tensor {name!r} is {found.dtype} of shape {tuple(found.shape)}, '
                f'expected {like.dtype} of shape {tuple(like.shape)}')
        if found.is_floating_point() and not bool(found.isfinite().all()):
            raise ValueError(f'{path}: tensor {name!r} has a value that is not finite')
