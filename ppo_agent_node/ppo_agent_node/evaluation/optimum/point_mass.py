# SPDX-License-Identifier: Apache-2.0
"""Point-mass model of a rocket: world `rocket` step by step, with thrust in any direction."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class PointMass:
    """The vehicle of a rocket world without its attitude; the world's own integration."""

    dt: float
    """s, the world's step."""
    substeps: int
    dry_mass: float
    """kg."""
    fuel: float
    """kg, at the start."""
    max_thrust: float
    """N."""
    exhaust_speed: float
    """m/s, specific impulse times g."""
    gravity: float
    """m/s^2."""
    drag: float
    """kg/m, drag over the square of the speed."""

    @staticmethod
    def of(settings: Mapping[str, float]) -> PointMass:
        """Return the vehicle of a world.

        :param settings: of a rocket world, by name, as in `WorldSpec.settings`.
        :raises KeyError: when a constant is missing.
        """
        return PointMass(
            dt=settings['dt'], substeps=int(settings['substeps']),
            dry_mass=settings['dry_mass'], fuel=settings['fuel'],
            max_thrust=settings['max_thrust'],
            exhaust_speed=settings['specific_impulse'] * settings['gravity'],
            gravity=settings['gravity'],
            drag=0.5 * settings['air_density'] * settings['drag_coefficient']
            * settings['drag_area'])

    @property
    def mass(self) -> float:
        """Mass at the start, kg."""
        return self.dry_mass + self.fuel

    def step(self, position: F64, velocity: F64, mass: F64, thrust: F64) -> tuple[F64, F64, F64]:
        """Return position and velocity `(K, 3)` and mass `(K,)` after one step of the world.

        :param position: `(K, 3)` m, y up.
        :param velocity: `(K, 3)` m/s.
        :param mass: `(K,)` kg.
        :param thrust: `(K, 3)` N, held for the step.
        """
        dt = self.dt / self.substeps
        flow = np.linalg.norm(thrust, axis=1) / self.exhaust_speed
        for _ in range(self.substeps):
            per_mass = (dt / mass)[:, None]
            speed = np.linalg.norm(velocity, axis=1, keepdims=True)
            velocity = velocity * (1.0 - self.drag * speed * per_mass) + thrust * per_mass
            velocity[:, 1] -= self.gravity * dt
            position = position + velocity * dt
            mass = mass - flow * dt
        return position, velocity, mass
