# SPDX-License-Identifier: Apache-2.0
"""World `rocket` against the closed forms of its physics."""
from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rocket_sim_node import worlds
from rocket_sim_node.worlds.rocket.world import RocketWorld

F64 = NDArray[np.float64]

DT, G = 0.02, 9.81
THRUST, DRY, FUEL, ISP = 470_880.0, 22_000.0, 2_000.0, 282.0
MASS = DRY + FUEL
FLOW = THRUST / (ISP * G)
SPIN_UP = 2e6 / 5e5
DRAG = 0.5 * 1.225 * 0.30 * 10.8
OFF, FULL, HOVER = -1.0, 1.0, 0.0
WIDE: dict[str, Any] = {
    'height_limit': 1e5, 'range_limit': 1e4, 'tilt_limit': 180.0, 'time_limit': 1e4,
}


def upright(num_envs: int = 1, **settings: Any) -> RocketWorld:
    """Return rockets that stand still in the air, upright, at x = z = 0."""
    return worlds.make('rocket', num_envs, level=1, spawn_angle=0, **settings)


def fly(world: RocketWorld, steps: int, throttle: float, x: float = 0.0, z: float = 0.0) -> None:
    """Hold one action for some steps, in which no episode may end."""
    action = np.tile([throttle, x, z], (world.spec.num_envs, 1))
    for _ in range(steps):
        _, _, terminated, _, _ = world.step(action)
        assert not terminated.any()


def test_free_fall_is_the_closed_form_of_semi_implicit_euler() -> None:
    """After n steps v = -n g dt and y = y0 - g dt^2 n (n + 1) / 2; explicit Euler has n - 1."""
    world = upright(air_density=0.0)
    n = 300
    fly(world, n, OFF)
    assert world.velocity[:, 0] == pytest.approx([0, -n * G * DT, 0], abs=1e-9)
    assert world.position[:, 0] == pytest.approx([0, 200 - G * DT**2 * n * (n + 1) / 2, 0],
                                                 abs=1e-9)
    explicit = 200 - G * DT**2 * n * (n - 1) / 2
    assert world.position[1, 0] - explicit == pytest.approx(-G * DT**2 * n, abs=1e-9)


@pytest.mark.parametrize('dt', [0.04, 0.02, 0.01])
def test_free_fall_nears_the_parabola_in_proportion_to_dt(dt: float) -> None:
    """The error at time t is g t dt / 2, no more and no less."""
    world = upright(air_density=0.0, dt=dt)
    fly(world, round(4.0 / dt), OFF)
    assert world.position[1, 0] - (200 - G * 4.0**2 / 2) == pytest.approx(-G * 4.0 * dt / 2,
                                                                          abs=1e-9)


@pytest.mark.parametrize('substeps', [1, 4, 25])
def test_substeps_are_smaller_steps_of_the_same_length(substeps: int) -> None:
    """100 steps with n substeps fall as 100 n steps of dt / n."""
    world = upright(air_density=0.0, substeps=substeps)
    fly(world, 100, OFF)
    n = 100 * substeps
    assert world.position[1, 0] == pytest.approx(
        200 - G * (DT / substeps) ** 2 * n * (n + 1) / 2, abs=1e-9)


def test_drag_of_one_step_by_hand() -> None:
    """Against the velocity, 1/2 rho Cd A v^2, in a direction with all three components."""
    world = upright(gravity=0.0)
    before = np.array([10.0, -40.0, 20.0])
    world.velocity[:, 0] = before
    fly(world, 1, OFF)
    deceleration = DRAG * np.sqrt(2100.0) * before / MASS
    assert world.velocity[:, 0] == pytest.approx(before - deceleration * DT, abs=1e-12)


@pytest.mark.parametrize(('substeps', 'wind'), [(1, 0.0), (10, 0.0), (1, 30.0), (10, 30.0)])
def test_drag_never_reverses_the_velocity_relative_to_the_air(
        substeps: int, wind: float) -> None:
    """However large it is: an explicit step would overshoot, and diverge."""
    world = upright(
        4, gravity=0.0, drag_coefficient=100.0, drag_area=1e4, substeps=substeps, wind_speed=wind)
    world.velocity[:] = [[10.0], [-40.0], [20.0]]
    fly(world, 1, OFF)
    blows = np.array(world.vehicles.wind) if wind else np.zeros((3, 4))
    assert np.linalg.norm(blows, axis=0) == pytest.approx([wind] * 4)
    assert world.velocity == pytest.approx(blows, abs=1e-9)


def test_the_first_substep_decides_on_hovering_and_reported_throttle() -> None:
    """Fuel that runs out within a step does not change the throttle of that step."""
    one, many = (upright(dt=0.1, substeps=n, fuel=3.0) for n in (1, 10))
    for world in (one, many):
        world.velocity[1] = -1.0
        fly(world, 1, FULL)
        assert world.fuel[0] == 0.0
        assert world.telemetry(np.arange(1)).throttle[0] == 1.0
    assert one.log.hover[0] == many.log.hover[0] == 1
    slow, fast = (upright(dt=0.1, substeps=10, max_thrust=2e6) for _ in range(2))
    slow.velocity[1], fast.velocity[1] = -1.9, 2.1
    for world, hover in ((slow, 1), (fast, 0)):
        fly(world, 1, FULL)
        assert world.log.hover[0] == hover


def test_coasting_slows_down_hyperbolically() -> None:
    """Without gravity 1/v grows by k t / m; the error is of first order and its sign known."""
    world = upright(gravity=0.0, range_limit=1e4, dt=0.001)
    world.velocity[:, 0] = [300.0, 0.0, 0.0]
    fly(world, 2000, OFF)
    exact = 1 / (1 / 300 + DRAG / MASS * 2.0)
    assert world.velocity[0, 0] == pytest.approx(exact, rel=1e-5)
    assert world.velocity[0, 0] < exact


def test_fall_in_thick_air_follows_the_hyperbolic_tangent() -> None:
    """From rest v = -vt tanh(g t / vt) and y = y0 - vt^2/g ln cosh(g t / vt), within O(dt)."""
    dt, time = 0.001, 4.0
    terminal = np.sqrt(MASS * G / (0.5 * 100 * 0.30 * 10.8))
    world = upright(air_density=100.0, dt=dt)
    fly(world, round(time / dt), OFF)
    speed = terminal * np.tanh(G * time / terminal)
    fallen = terminal**2 / G * np.log(np.cosh(G * time / terminal))
    assert world.velocity[1, 0] == pytest.approx(-speed, abs=G * dt)
    assert world.position[1, 0] == pytest.approx(200 - fallen, abs=G * dt * time)
    assert speed > 0.75 * terminal


def test_terminal_velocity_is_a_fixed_point() -> None:
    """Weight and drag in balance, 344 m/s in ordinary air: the speed stays to the bit or so."""
    terminal = np.sqrt(MASS * G / DRAG)
    assert terminal == pytest.approx(344.4, abs=0.1)
    world = upright(spawn_height=10_000.0, height_limit=1e5)
    world.velocity[1, 0] = -terminal
    fly(world, 200, OFF)
    assert world.velocity[1, 0] == pytest.approx(-terminal, abs=1e-9)


@pytest.mark.parametrize(('action', 'throttle'), [
    (-1.0, 0.0), (-0.9801, 0.0), (-0.9799, 0.01005), (0.0, 0.5), (1.0, 1.0),
    (-3.0, 0.0), (7.0, 1.0),
])
def test_throttle_maps_to_0_to_1_and_is_cut_off_at_one_percent(
    action: float, throttle: float,
) -> None:
    """Seen in the fuel: thrust / (Isp g) dt."""
    world = upright()
    fly(world, 1, action)
    assert FUEL - world.fuel[0] == pytest.approx(throttle * FLOW * DT, abs=1e-9)
    assert world.telemetry(np.arange(1)).thrust[0] == pytest.approx(throttle * THRUST)


def test_the_engine_is_off_at_the_cut_off_itself() -> None:
    """At or below: with a cut-off that binary holds exactly."""
    for action, burns in ((-0.5, False), (-0.5 + 1e-9, True)):
        world = upright(throttle_cutoff=0.25)
        fly(world, 1, action)
        assert (world.fuel[0] < FUEL) == burns


def test_full_throttle_burns_170_kg_a_second() -> None:
    """Linear in time."""
    world = upright(**WIDE)
    fly(world, 500, FULL)
    assert pytest.approx(170.2, abs=0.05) == FLOW
    assert world.fuel[0] == pytest.approx(FUEL - 500 * DT * FLOW, abs=1e-9)


def test_burn_gains_the_speed_of_tsiolkovsky() -> None:
    """Isp g ln(m0 / m) - g t, between the sums of thrust over mass from the left and right."""
    world = upright(air_density=0.0, **WIDE)
    n = 500
    fly(world, n, FULL)
    masses = MASS - FLOW * DT * np.arange(n + 1)
    left = np.sum(THRUST * DT / masses[:-1])
    right = np.sum(THRUST * DT / masses[1:])
    exact = ISP * G * np.log(masses[0] / masses[-1])
    assert world.velocity[1, 0] == pytest.approx(left - n * DT * G, abs=1e-9)
    assert left < exact < right
    assert left == pytest.approx(exact, rel=1e-4)


def test_empty_tanks_end_the_burn() -> None:
    """Never below zero, from then on free fall, and the mass is the dry one."""
    world = upright(fuel=100.0, air_density=0.0)
    burning = int(np.ceil(100.0 / (FLOW * DT)))
    fly(world, burning, FULL)
    assert world.fuel[0] == 0
    speed = world.velocity[1, 0]
    fly(world, 10, FULL)
    assert world.fuel[0] == 0
    assert world.velocity[1, 0] - speed == pytest.approx(-10 * G * DT, abs=1e-12)
    state = world.telemetry(np.arange(1))
    assert (state.throttle[0], state.thrust[0], state.mass[0]) == (0, 0, DRY)


def test_hover_throttle_holds_the_height() -> None:
    """Thrust equal to the weight of the moment: half throttle at first, less as fuel burns."""
    world = upright()
    for step in range(300):
        throttle = (DRY + world.fuel[0]) * G / THRUST
        if step == 0:
            assert throttle == pytest.approx(0.5, abs=1e-12)
        fly(world, 1, 2 * throttle - 1)
    assert np.abs(world.velocity).max() < 1e-11
    assert world.position[:, 0] == pytest.approx([0, 200, 0], abs=1e-10)
    # dm/dt = -m / Isp, by Euler's steps.
    assert DRY + world.fuel[0] == pytest.approx(MASS * (1 - DT / ISP) ** 300, abs=1e-6)


def test_thrust_points_along_the_bodys_up_axis() -> None:
    """An attitude turned about both axes; the step's acceleration is thrust over mass."""
    world = upright(gravity=0.0, air_density=0.0)
    attitude = Rotation.from_euler('xz', [20, -35], degrees=True)
    world.attitude[:, 0] = attitude.as_quat()
    fly(world, 1, FULL)
    expected = attitude.apply([0, 1, 0]) * THRUST / MASS * DT
    assert world.velocity[:, 0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(('x', 'z'), [(1, 0), (0, 1), (-0.5, 0), (0, -0.25), (0.6, -0.8)])
def test_torque_turns_about_the_world_axes(x: float, z: float) -> None:
    """Rate n a dt and angle a dt^2 n (n + 1) / 2, right-handed about (x, 0, z)."""
    world = upright(tilt_limit=180.0)
    n = 40
    fly(world, n, OFF, x, z)
    assert world.spin[:, 0] == pytest.approx(np.array([x, 0, z]) * SPIN_UP * n * DT, abs=1e-12)
    angle = np.array([x, 0, z]) * SPIN_UP * DT**2 * n * (n + 1) / 2
    expected = Rotation.from_rotvec(angle)
    turned = Rotation.from_quat(world.attitude[:, 0])
    assert (turned * expected.inv()).magnitude() == pytest.approx(0, abs=1e-12)
    up = world.observe()[0, 6:9]
    assert up == pytest.approx(expected.apply([0, 1, 0]), abs=1e-7)


def test_torque_is_about_the_worlds_axes_even_when_tilted() -> None:
    """A rocket that lies over gains spin about world X and Z alone, and nothing is coupled."""
    world = upright(tilt_limit=180.0, yaw_damping=0.0)
    world.attitude[:, 0] = Rotation.from_euler('xz', [60, 40], degrees=True).as_quat()
    world.spin[:, 0] = [0.3, 2.0, -0.4]
    fly(world, 10, OFF, 0.5, -0.25)
    gained = np.array([0.5, 0, -0.25]) * SPIN_UP * 10 * DT
    assert world.spin[:, 0] == pytest.approx(np.array([0.3, 2.0, -0.4]) + gained, abs=1e-12)


@pytest.mark.parametrize('substeps', [1, 10])
def test_yaw_rate_loses_five_percent_a_step(substeps: int) -> None:
    """0.95^n however fine the step is divided, and the other rates are not touched."""
    world = upright(substeps=substeps, tilt_limit=180.0)
    world.spin[:, 0] = [0.1, 2.0, -0.2]
    fly(world, 60, OFF)
    assert world.spin[:, 0] == pytest.approx([0.1, 2 * 0.95**60, -0.2], abs=1e-12)


def test_undisturbed_spin_turns_at_a_constant_rate() -> None:
    """A spherical inertia knows no precession: the attitude is one rotation about one axis."""
    world = upright(yaw_damping=0.0, tilt_limit=180.0)
    rate = np.array([0.7, -1.1, 0.4])
    world.spin[:, 0] = rate
    fly(world, 200, OFF)
    expected = Rotation.from_rotvec(rate * 200 * DT)
    turned = Rotation.from_quat(world.attitude[:, 0])
    assert (turned * expected.inv()).magnitude() == pytest.approx(0, abs=1e-12)


def test_telemetry_holds_the_forces_of_the_step() -> None:
    """Units of RocketState, y up."""
    world = upright(2)
    world.step(np.array([[0.5, 0.25, -1.0], [-1.0, 0.0, 0.0]]))
    state = world.telemetry(np.array([0, 1]))
    assert state.throttle.tolist() == [0.75, 0.0]
    assert state.thrust == pytest.approx([0.75 * THRUST, 0])
    assert state.torque == pytest.approx(np.array([[5e5, 0, -2e6], [0, 0, 0]]))
    assert state.mass == pytest.approx(DRY + world.fuel)
    assert state.time == pytest.approx([DT, DT])
    assert state.position.shape == (2, 3)
    assert state.orientation.shape == (2, 4)
