# SPDX-License-Identifier: Apache-2.0
"""Dense layers and matrix products without autograd, by the library that is quickest at them.

PyTorch leaves float32 products to MKL, which runs at half the speed of a processor that is not
Intel's, and takes a second pass for the tanh, half as long as the product. oneDNN, which comes
with it as well, knows all processors and does both at once; PyTorch offers it by the operations
that its own compiler emits. All of it is float32 and differs in the last bits.
"""
from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

_LEAST = 32
"""Rows and columns of a result from which on oneDNN's fixed costs, 15 us, are worth it."""


def dense(x: Tensor, weight: Tensor, bias: Tensor, activation: str) -> Tensor:
    """Return the activation of `x weight^T + bias`, `(S, K)`.

    :param x: `(S, D)`.
    :param weight: `(K, D)`.
    :param activation: `tanh` or `relu`.
    """
    if _swift(x, len(x), len(weight)):
        # Its relu makes 0 of what is not a number; a policy must not hide that.
        fused = activation if activation == 'tanh' else 'none'
        y: Tensor = torch.ops.mkldnn._linear_pointwise(x, weight, bias, fused, [], '')
        if fused == activation:
            return y
    else:
        y = functional.linear(x, weight, bias)
    return y.tanh_() if activation == 'tanh' else y.relu_()


def product(left: Tensor, right: Tensor) -> Tensor:
    """Return the matrix product `(M, N)` of `(M, K)` and `(K, N)`."""
    if _swift(left, len(left), right.shape[1]):
        found: Tensor = torch.ops.mkldnn._linear_pointwise(left, right.T, None, 'none', [], '')
        return found
    return left @ right


def _swift(x: Tensor, rows: int, columns: int) -> bool:
    """Return whether oneDNN can do it and is quicker."""
    return (rows >= _LEAST and columns >= _LEAST and x.numel() > 0 and x.device.type == 'cpu'
            and x.dtype == torch.float32 and torch.backends.mkldnn.is_available())
