# SPDX-License-Identifier: Apache-2.0
"""Dense layers and matrix products without autograd, by the library that is quickest at them.

PyTorch leaves float32 products to MKL, which takes twice as long as it need on processors that
are not Intel's, and computes a tanh in a pass of its own, half as long as a product of 256 units.
oneDNN, which comes with PyTorch as well, knows all processors and does both at once; PyTorch
offers it by the operations that its own compiler emits. All of it is float32; last bits differ.
"""
from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

_offered = torch.backends.mkldnn.is_available() and hasattr(torch.ops.mkldnn, '_linear_pointwise')

_LEAST = 32
"""Rows and columns of a result from which on oneDNN's fixed costs, 15 us, are worth it."""


def dense(x: Tensor, weight: Tensor, bias: Tensor, activation: str) -> Tensor:
    """Return the activation of `x weight^T + bias`, `(..., K)`.

    :param x: `(..., D)`.
    :param weight: `(K, D)`.
    :param activation: `tanh` or `relu`.
    """
    if not _swift(x, len(weight)):
        y = functional.linear(x, weight, bias)
    elif activation == 'tanh':
        return _one_dnn(x, weight, bias, 'tanh')
    else:
        # Its relu would make 0 of what is not a number; a policy must not hide that.
        y = _one_dnn(x, weight, bias)
    return y.tanh_() if activation == 'tanh' else y.relu_()


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
    """Return whether oneDNN can do it and is quicker."""
    return (columns >= _LEAST and x.numel() >= _LEAST * x.shape[-1] > 0 and _offered
            and x.device.type == 'cpu' and x.dtype == torch.float32)
