# SPDX-License-Identifier: Apache-2.0
"""The agreement of policy gradients in `bench gradients`."""
from __future__ import annotations

import pytest
import torch
from benchmarks.learning.gradients import agreement


def test_equal_gradients_agree_and_orthogonal_ones_do_not() -> None:
    assert agreement([torch.tensor([3.0, 4.0])] * 5) == pytest.approx((1.0, 0.0))
    assert agreement(list(torch.eye(5))) == pytest.approx((0.0, 0.0))


def test_noise_of_equal_size_as_the_gradient_halves_the_agreement() -> None:
    generator = torch.Generator().manual_seed(1)
    noise = torch.randn(400, 3000, generator=generator, dtype=torch.float64)
    found, error = agreement(list(noise + 1.0))
    assert found == pytest.approx(0.5, abs=4 * error)
    assert 0 < error < 0.02
