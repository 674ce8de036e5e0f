# SPDX-License-Identifier: Apache-2.0
"""Attitude control law: proportional-derivative, with a speed limit for timely braking."""
from __future__ import annotations

import numpy as np

from rocket_sim_node.worlds.base import F64


def attitude_torque(
    up: F64, spin: F64, wanted: F64, full: float | F64, rate: float, damping: float,
    brake_share: float, turning: F64 | float = 0.0,
) -> F64:
    """Return the torque `(2, N)` about X and Z, 1 for full RCS, not yet clipped.

    Proportional to the error, up x wanted, and the spin. For large errors, the wanted spin is
    limited to what a share of the RCS can stop within the remaining angle.

    :param up: `(3, N)`, the body's axis.
    :param spin: `(2, N)` rad/s, about X and Z.
    :param wanted: `(3, N)` or `(3,)`, wanted direction of the axis.
    :param full: rad/s^2, full RCS.
    :param rate: rad/s, natural frequency of a loop with the damping ratio `damping`.
    :param brake_share: share of the RCS available to stop a turn.
    :param turning: `(2, N)` rad/s about X and Z, spin of the wanted axis itself, fed forward.
    """
    error = np.stack((up[1] * wanted[2] - up[2] * wanted[1],
                      up[0] * wanted[1] - up[1] * wanted[0]))
    angle = np.maximum(np.hypot(*error), 1e-12)
    linear = rate / (2 * damping)
    stoppable = np.sqrt(2 * brake_share * full / angle)
    wanted_spin: F64 = np.minimum(linear, stoppable) * error
    return (wanted_spin + turning - spin) * (2 * damping * rate / full)
