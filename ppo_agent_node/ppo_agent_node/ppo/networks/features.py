# SPDX-License-Identifier: Apache-2.0
"""Features of a descent, computed from an observation as additional network inputs.

A landing depends on quotients: the required deceleration is v^2 / 2h, the flare has a constant
v / h, and guidance to the pad weighs distance by 1 / t^2 and drift by 1 / t, with t the time to go
(Klumpp, 'Apollo lunar descent guidance', Automatica 10, 1974). Perceptrons approximate quotients
badly, especially over four decades of height. All features are compressed by asinh, linear near
zero and logarithmic beyond, so that millimetres and hundreds of metres are both resolved.
"""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch import nn

_NEEDED = (
    'position_x', 'position_z', 'velocity_x', 'velocity_y', 'velocity_z', 'up_x', 'up_z',
    'spin_x', 'spin_z', 'pad_y',
)
"""Entries of an observation that are used; policy files hold their scales in this order."""
_DIRECT = (
    'pad_y', 'position_x', 'position_z', 'velocity_y', 'velocity_x', 'velocity_z', 'up_x', 'up_z',
    'spin_x', 'spin_z',
)
"""Those whose values are the first features, in the order of the features."""
_LEAST_HEIGHT = 0.001
"""m, added to a height used as a divisor."""
_WIDTHS = (
    0.002, 0.2, 0.2,    # m: height, x, z
    0.005, 0.05, 0.05,  # m/s: speed downwards, along x and z
    0.01, 0.01,        # up vector x, z
    0.05, 0.05,        # rad/s: spin x, z
    1.0, 1.0, 1.0,     # g needed, s to go, 1/s flare rate
    0.1, 0.1, 0.1, 0.1,  # g: distance / t^2 and drift / t, along x and z
)
"""Widths of the features' linear ranges."""
_GUIDANCE_WIDTHS = (
    1.0, 1.0,          # m: zero-effort miss along x and z
    0.1, 0.1,          # stopping lean along x and z
)
"""The same for the features of guidance."""
_NAMES = (
    'height', 'position_x', 'position_z', 'fall', 'velocity_x', 'velocity_z', 'up_x', 'up_z',
    'spin_x', 'spin_z', 'deceleration', 'time', 'flare', 'pull_x', 'pull_z', 'brake_x', 'brake_z',
)
_GUIDANCE_NAMES = ('miss_x', 'miss_z', 'lean_x', 'lean_z')
_FIRST_SCALES = (0.3,) * 13 + (3.0,) * 4
"""Scales that bring features to the order of 1 when there are no samples to fit them: logarithms
go up to 10, and guidance terms are some hundredths of g until shortly before touchdown."""


class Numpy:
    """NumPy by the names that its operations have in PyTorch; the results are the same bits.

    In flight, an operation on hundreds of numbers costs as much as its call, which takes NumPy a
    fraction of the time.
    """

    abs, sign, concatenate, clamp_min = np.abs, np.sign, np.concatenate, np.maximum

    @staticmethod
    def sqrt(x: NDArray[np.float32]) -> NDArray[np.float32]:
        """Replace `x` by its square root; NumPy's has other last bits."""
        return torch.from_numpy(x).sqrt_().numpy()

    @staticmethod
    def log1p(x: NDArray[np.float32]) -> NDArray[np.float32]:
        """Replace `x` by log(1 + x); NumPy's has other last bits."""
        return torch.from_numpy(x).log1p_().numpy()


def asinh(x: Any, xp: Any = torch) -> Any:
    """Return the inverse hyperbolic sine of numbers.

    PyTorch's own is not vectorised and takes several times as long. The relative error is that of
    float32, up to 1e19; infinity gives NaN.

    :param xp: the library of `x`: `torch` or `Numpy`.
    """
    size = xp.abs(x)
    root = xp.sqrt(x * x + 1.0) + 1.0
    return xp.log1p(size / root * size + size) * xp.sign(x)


def _features(direct: Any, gravity: Any, spin_up: Any, xp: Any) -> Any:
    """Return all features `(F, S)`, not compressed.

    :param direct: `(10, S)`, the first features.
    :param gravity: m/s^2.
    :param spin_up: nominal angular acceleration, rad/s^2; None: no guidance.
    :param xp: as in `asinh`.
    """
    # Rows are grouped: an operation costs as much as the arithmetic on hundreds of numbers.
    height, fall, position, drift = direct[0], direct[3], direct[1:3], direct[4:6]
    above = xp.clamp_min(height, 0.0) + _LEAST_HEIGHT
    time = 2 * above / (xp.clamp_min(fall, 0.0) + xp.sqrt(0.5 * gravity * above))
    per_time = 1 / (gravity * time)
    rows = [
        direct, (fall * xp.abs(fall) / (2 * gravity * above))[None], time[None],
        (fall / above)[None], position * per_time / time, drift * per_time]
    if spin_up is not None:
        up_x, up_z, spin_x, spin_z = direct[6:]
        rows += [
            position + drift * time, (up_x - spin_z * xp.abs(spin_z) / (2 * spin_up))[None],
            (up_z + spin_x * xp.abs(spin_x) / (2 * spin_up))[None]]
    return xp.concatenate(rows)


class DescentFeatures(nn.Module):
    """Computes features of a rocket's observations: heights, rates and derived quantities.

    The world's scales are stored with the weights, so that a policy file is self-contained.
    """

    columns: Tensor
    """`(10,)`, indices in the observation of the names in `_DIRECT`"""
    order: Tensor
    """`(10,)`, indices in `_NEEDED` of the same"""
    sign: Tensor
    """`(10,)`, -1 for the vertical velocity, which becomes the speed downwards"""
    scale: Tensor
    width: Tensor
    spin_up: Tensor
    """rad/s^2, with guidance only."""

    def __init__(
        self, names: Sequence[str], settings: Mapping[str, float], guidance: bool = False,
    ) -> None:
        """Determine columns and scales of a world.

        :param names: of the D entries of an observation.
        :param settings: of the world.
        :param guidance: append the zero-effort miss, the distance from the pad at which the rocket
            would land without correction (Zarchan, 'Tactical and strategic missile guidance'), and
            the stopping lean, the up vector's x and z at which the rocket would stop turning if
            its thrusters braked at once: s = up - w |w| / (2 a), a the nominal angular
            acceleration (the switching curve of a double integrator; Bryson and Ho, 'Applied
            optimal control', 1975).
        :raises ValueError: for a world whose observations are not those of a rocket.
        """
        super().__init__()
        self.compress: Callable[[Tensor], Tensor] = asinh
        missing = sorted(set(_NEEDED) - set(names))
        if missing:
            raise ValueError(
                f"features: got {'guidance' if guidance else 'descent'!r}, expected 'none' for a "
                f'world that does not observe {", ".join(missing)}')
        self.register_buffer(
            'columns', torch.tensor([names.index(name) for name in _DIRECT]), persistent=False)
        self.register_buffer(
            'order', torch.tensor([_NEEDED.index(name) for name in _DIRECT]), persistent=False)
        self.register_buffer('sign', torch.tensor(
            [-1.0 if name == 'velocity_y' else 1.0 for name in _DIRECT]), persistent=False)
        position, velocity = settings['position_scale'], settings['velocity_scale']
        spin, gravity = settings['spin_scale'], max(settings['gravity'], 1e-6)
        # In the order of _NEEDED: metres, metres per second, 1, radians per second; then gravity.
        self.register_buffer('scale', torch.tensor(
            [position] * 2 + [velocity] * 3 + [1.0] * 2 + [spin] * 2 + [-position, gravity]))
        self._guidance = guidance
        if guidance:
            self.register_buffer(
                'spin_up', torch.tensor(max(settings['rcs_torque'] / settings['inertia'], 1e-6)))
        widths = _WIDTHS + _GUIDANCE_WIDTHS if guidance else _WIDTHS
        self.count = len(widths)
        self.first_scale = torch.tensor(_FIRST_SCALES + (0.5,) * 4 if guidance else _FIRST_SCALES)
        self.register_buffer('width', torch.tensor(widths)[:, None])

    def forward(self, observation: Tensor) -> Tensor:
        """Return the features `(..., F)` of observations `(..., D)`."""
        flat = observation.reshape(-1, observation.shape[-1])
        direct = flat.index_select(1, self.columns).T * self._direct_scale()
        features = _features(
            direct, self.scale[-1], self.spin_up if self._guidance else None, torch)
        compressed = self.compress(features / self.width)
        return compressed.T.reshape(*observation.shape[:-1], self.count)

    def in_flight(self) -> Callable[[Tensor], Tensor]:
        """Return a function that computes `forward`, bit for bit, with less overhead.

        On a CPU it uses NumPy, which takes less time for up to some thousands of observations. It
        takes the scales from now.
        """
        if self.scale.device.type != 'cpu':
            return self
        columns, width = self.columns.numpy(), self.width.numpy()
        scale, gravity = self._direct_scale().numpy(), self.scale[-1].numpy()[()]
        spin_up = self.spin_up.numpy()[()] if self._guidance else None

        @np.errstate(all='ignore')  # as in PyTorch
        def features(observation: Tensor) -> Tensor:
            seen = observation.numpy().reshape(-1, observation.shape[-1])
            direct = np.multiply(seen.take(columns, 1).T, scale, order='C')
            found = asinh(_features(direct, gravity, spin_up, Numpy) / width, Numpy)
            return torch.from_numpy(found).T.reshape(*observation.shape[:-1], self.count)

        return features

    def _direct_scale(self) -> Tensor:
        """Return the factors `(10, 1)` between observations and the first features."""
        return (self.scale.index_select(0, self.order) * self.sign)[:, None]


def feature_names(kind: str) -> tuple[str, ...]:
    """Return the names of the features of a kind, in their order."""
    return {'none': (), 'descent': _NAMES, 'guidance': _NAMES + _GUIDANCE_NAMES}[kind]


def used_observations(kind: str) -> frozenset[str]:
    """Return the names of the observations from which the features of a kind are computed."""
    return frozenset(() if kind == 'none' else _NEEDED)


def make_features(
    kind: str, names: Sequence[str], settings: Mapping[str, float],
) -> DescentFeatures | None:
    """Return the module that computes features of a kind, None for none.

    :raises ValueError: for a world that lacks the required inputs.
    """
    return None if kind == 'none' else DescentFeatures(names, settings, kind == 'guidance')
