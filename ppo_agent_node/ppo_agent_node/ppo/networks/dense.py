# SPDX-License-Identifier: Apache-2.0
"""Dense layers and matrix products without autograd, by the faster of two libraries.

PyTorch uses MKL for float32 products, which does not use AVX-512 on processors not made by Intel
and takes twice as long as necessary there. oneDNN, included with PyTorch, does, and fuses the
product with a tanh; it is available through the operations that PyTorch's own compiler emits.
Without AVX-512, MKL is faster, because it does not copy transposed matrices first. Its tanh takes
longer than PyTorch's sigmoid, so tanh is computed as 2 sigmoid(2 x) - 1.
All of it is float32; the last bits differ.
"""
from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

_offered = (
    torch.backends.cpu.get_cpu_capability() == 'AVX512' and torch.backends.mkldnn.is_available()
    and hasattr(torch.ops.mkldnn, '_linear_pointwise'))

_LEAST = 32
"""Minimum rows and columns of a result for which oneDNN's fixed costs, 15 us, pay off."""

_BLOCK = 32
"""PyTorch computes sigmoids in blocks of at most this size, and a remainder in another way, with
other last bits. The actions of a rocket would then depend on its place in the batch."""
_MINUS_ONE = torch.tensor(-1.0)


def dense(x: Tensor, weight: Tensor, bias: Tensor, activation: str) -> Tensor:
    """Return the activation of `x weight^T + bias`, `(..., K)`.

    :param x: `(..., D)`.
    :param weight: `(K, D)`.
    :param activation: `tanh` or `relu`.
    """
    swift = _swift(x, len(weight))
    if activation != 'tanh':
        # The relu of oneDNN would turn NaN into 0, and hide an invalid policy.
        y = _one_dnn(x, weight, bias) if swift else functional.linear(x, weight, bias)
        return y.relu_()
    if swift:
        return _one_dnn(x, weight, bias, 'tanh')
    if x.dim() == 2 and x.device.type == 'cpu' and len(weight) % _BLOCK == 0:
        twice = torch.addmm(bias + bias, x, weight.T, alpha=2)
        return torch.add(_MINUS_ONE, twice.sigmoid_(), alpha=2, out=twice)
    return functional.linear(x, weight, bias).tanh_()


def product(left: Tensor, right: Tensor) -> Tensor:
    """Return the matrix product `(M, N)` of `(M, K)` and `(K, N)`."""
    return _one_dnn(left, right.T) if _swift(left, right.shape[1]) else left @ right


def add_product(total: Tensor, left: Tensor, right: Tensor) -> None:
    """Add the matrix product of `(M, K)` and `(K, N)` to `total`, `(M, N)`, in place."""
    if _swift(left, right.shape[1]):
        total.add_(_one_dnn(left, right.T))
    else:
        total.addmm_(left, right)


def _one_dnn(
    x: Tensor, weight: Tensor, bias: Tensor | None = None, activation: str = 'none',
) -> Tensor:
    found: Tensor = torch.ops.mkldnn._linear_pointwise(x, weight, bias, activation, [], '')
    return found


def _swift(x: Tensor, columns: int) -> bool:
    """Return whether oneDNN is applicable and faster."""
    return (columns >= _LEAST and x.numel() >= _LEAST * x.shape[-1] > 0 and _offered
            and x.device.type == 'cpu' and x.dtype == torch.float32)
