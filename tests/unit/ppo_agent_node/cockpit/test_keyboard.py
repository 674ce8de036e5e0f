# SPDX-License-Identifier: Apache-2.0
"""The keyboard pilot: keys and times in, actions out; and level 1 can be landed by keys."""
from __future__ import annotations

import math

import numpy as np
import pytest

from ppo_agent_node.cockpit.debrief import ExpertFlight
from ppo_agent_node.cockpit.debrief import FlightSummary
from ppo_agent_node.cockpit.debrief import Watch
from ppo_agent_node.cockpit.instruments import Brake
from ppo_agent_node.cockpit.instruments import Readings
from ppo_agent_node.cockpit.instruments import read
from ppo_agent_node.cockpit.key_bindings import KeyboardCommands
from ppo_agent_node.pilots.expert.expert import ExpertPilot
from ppo_agent_node.pilots.keyboard import KeyboardPilot
from ppo_agent_node.pilots.keyboard import KeyboardSettings
from ppo_agent_node.pilots.keys import KeyEvent
from ppo_agent_node.pilots.keys import Motion
from rocket_sim_node import worlds
from rocket_sim_node.worlds.base import SimulatedWorld
from rocket_sim_node.worlds.lunar import vehicle


def press(pilot: KeyboardPilot, keys: str, now: float = 0.0) -> None:
    """Press keys by their names, spaces between."""
    for key in keys.split():
        assert pilot.press(KeyEvent(key), now)


@pytest.fixture
def rocket() -> SimulatedWorld:
    """One rocket over the pad, upright within 5 deg."""
    return worlds.make('rocket', 1, 0, level=1)


@pytest.mark.parametrize(('keys', 'throttle'), [
    ('', 0.0), ('w', 0.05), ('w w w s', 0.10), ('s', 0.0), ('z', 1.0), ('z w', 1.0),
    ('z s', 0.95), ('z x', 0.0), ('4', 0.4), ('4 w', 0.45), ('9 0', 0.0), ('space', 1.0),
    ('space x', 0.0), ('space 3', 0.3),
])
def test_throttle_keys(rocket: SimulatedWorld, keys: str, throttle: float) -> None:
    pilot = KeyboardPilot(rocket.spec)
    press(pilot, keys)
    assert pilot.throttle(0.1) == throttle
    action = pilot.act(rocket.observe(), 0.1)
    assert action.shape == (1, 3)
    assert action.dtype == np.float32
    assert action[0, 0] == pytest.approx(2 * throttle - 1)


def test_space_burns_while_held_and_then_the_set_throttle_returns(
        rocket: SimulatedWorld) -> None:
    pilot = KeyboardPilot(rocket.spec)
    press(pilot, '3')
    press(pilot, 'space', 1.0)
    for k in range(30):
        press(pilot, 'space', 1.5 + k / 30)
        assert pilot.throttle(1.5 + k / 30) == 1.0
    assert pilot.throttle(2.7) == 0.3
    pilot.reset()
    assert pilot.throttle(2.7) == 0.0


def test_keys_that_the_pilot_does_not_use_are_ignored(rocket: SimulatedWorld) -> None:
    pilot = KeyboardPilot(rocket.spec)
    for key in ('q', 'r', 'h', 'enter', 'ctrl+c', '²', '٣'):
        assert not pilot.press(KeyEvent(key), 0.0)


def test_opposite_arrow_ends_the_other_and_two_axes_go_together(
        rocket: SimulatedWorld) -> None:
    pilot = KeyboardPilot(rocket.spec)
    press(pilot, 'left up')
    assert pilot.sideways(0.1) == (-1, -1)
    press(pilot, 'd')
    assert pilot.sideways(0.1) == (1, -1)
    assert pilot.sideways(0.7) == (0, 0)


@pytest.mark.parametrize(('key', 'axis', 'sign'), [
    ('left', 0, -1), ('right', 0, 1), ('up', 1, -1), ('down', 1, 1)])
def test_assist_holds_the_lean_asked_for_and_rights_the_rocket(
        rocket: SimulatedWorld, key: str, axis: int, sign: int) -> None:
    pilot = KeyboardPilot(rocket.spec, KeyboardSettings(lean=8.0))
    pilot.know_releases()
    observation = rocket.reset(3, level=4)
    assert read(rocket.spec, observation[0]).tilt > 10.0
    press(pilot, key)
    for step in range(75):
        observation = rocket.step(pilot.act(observation, 0.02 * step))[0]
    lean = read(rocket.spec, observation[0]).lean
    assert lean[axis] == pytest.approx(8.0 * sign, abs=0.3)
    assert lean[1 - axis] == pytest.approx(0.0, abs=0.3)
    pilot.press(KeyEvent(key, Motion.RELEASE), 1.5)
    for step in range(75, 150):
        observation = rocket.step(pilot.act(observation, 0.02 * step))[0]
    assert read(rocket.spec, observation[0]).tilt < 0.3


def test_without_assist_a_tap_leaves_a_spin(rocket: SimulatedWorld) -> None:
    pilot = KeyboardPilot(rocket.spec, KeyboardSettings(assist=False))
    observation = rocket.observe()
    press(pilot, 'right')
    for step in range(20):
        observation = rocket.step(pilot.act(observation, 0.02 * step))[0]
    # 0.1 s, both ends counted, of a quarter of 2e6 N m on 5e5 kg m^2: to the right about -Z.
    assert observation[0, 11] * 10 == pytest.approx(-0.12)
    assert observation[0, 9] == 0.0


def test_actions_are_finite_and_bounded_for_any_observation(rocket: SimulatedWorld) -> None:
    for assist in (True, False):
        pilot = KeyboardPilot(rocket.spec, KeyboardSettings(assist=assist))
        press(pilot, 'left up space')
        for value in (np.nan, np.inf, -1e30):
            with np.errstate(all='ignore'):
                action = pilot.act(np.full((2, 15), value, np.float32), 0.0)
            assert np.isfinite(action).all()
            assert (np.abs(action) <= 1).all()


def test_worlds_without_keys_are_refused(rocket: SimulatedWorld) -> None:
    from dataclasses import replace
    with pytest.raises(ValueError, match="'elsewhere', expected one of rocket"):
        KeyboardPilot(replace(rocket.spec, name='elsewhere', action_names=('a',)))


# The lander

def test_lander_engines() -> None:
    world = worlds.make('lunar_lander', 1, 1)
    pilot = KeyboardPilot(world.spec, KeyboardSettings(assist=False))
    observation = world.observe()
    assert pilot.act(observation, 0.0).tolist() == [0]
    press(pilot, 'left')
    assert pilot.act(observation, 0.0).tolist() == [1]
    press(pilot, 'right')
    assert pilot.act(observation, 0.0).tolist() == [3]
    press(pilot, 'space', 1.0)
    assert pilot.act(observation, 1.0).tolist() == [2]
    press(pilot, '3', 2.0)
    fired = [int(pilot.act(observation, 2.0 + 0.02 * k)[0] == 2) for k in range(100)]
    assert sum(fired) == 30
    assert max(np.diff(np.flatnonzero(fired))) == 4


@pytest.mark.parametrize(('keys', 'throttle', 'off'), [
    ('0', 0.0, 20), ('1', 0.1, 16), ('3', 0.3, 8), ('5', 0.5, 0), ('6', 0.6, 0), ('9', 0.9, 0),
    ('z', 1.0, 0)])
def test_a_continuous_lander_has_the_throttle_of_its_keys(
        keys: str, throttle: float, off: int) -> None:
    """The engine fires at 50 % or more, or in some of the steps."""
    world = worlds.make('lunar_lander', 1, 1, continuous=True)
    pilot = KeyboardPilot(world.spec, KeyboardSettings(assist=False))
    press(pilot, keys)
    fired = []
    observation = world.observe()
    for step in range(20):  # no flight ends earlier
        observation = world.step(pilot.act(observation, 0.02 * step))[0]
        fired.append(float(world.telemetry(np.array([0])).throttle[0]))
    assert np.mean(fired) == pytest.approx(throttle, abs=1e-5)
    assert fired.count(0.0) == off


def test_left_pushes_the_lander_left_and_assist_rights_it() -> None:
    for continuous in (False, True):
        world = worlds.make('lunar_lander', 1, 1, continuous=continuous)
        pilot = KeyboardPilot(world.spec)
        pilot.know_releases()
        observation = world.observe()
        press(pilot, 'left 5')
        drift = read(world.spec, observation[0]).drift[0]
        for step in range(60):
            observation = world.step(pilot.act(observation, 0.02 * step))[0]
        assert read(world.spec, observation[0]).lean[0] < -5.0
        assert read(world.spec, observation[0]).drift[0] < drift - 0.5
        pilot.press(KeyEvent('left', Motion.RELEASE), 1.2)
        for step in range(60, 120):
            observation = world.step(pilot.act(observation, 0.02 * step))[0]
        assert read(world.spec, observation[0]).tilt < 5.0


# Instruments

def test_readings_are_the_state(rocket: SimulatedWorld) -> None:
    rocket.reset(5, level=8)
    state = rocket.telemetry(np.array([0]))
    readings = read(rocket.spec, rocket.observe()[0])
    assert readings.height == pytest.approx(200.0 - 5.2, abs=1e-3)
    assert readings.climb == pytest.approx(state.linear_velocity[0, 1], abs=1e-4)
    assert readings.drift == pytest.approx(state.linear_velocity[0, ::2], abs=1e-4)
    assert readings.offset == pytest.approx(state.position[0, ::2], abs=1e-4)
    lander = worlds.make('lunar_lander', 1, 3)
    for _ in range(40):
        observation = lander.step(np.array([1]))[0]
    state, readings = lander.telemetry(np.array([0])), read(lander.spec, observation[0])
    # The state has the velocity of the hull's origin, observations that of its centre of gravity.
    arm = vehicle.HULL_CENTRE * state.angular_velocity[0, 2]
    lean = 2 * np.arctan2(*state.orientation[0, 2:])
    climb, drift = state.linear_velocity[0, 1::-1] - arm * np.array((np.sin(lean), np.cos(lean)))
    assert readings.climb == pytest.approx(climb, abs=1e-4)
    assert readings.drift[0] == pytest.approx(drift, abs=1e-4)
    assert readings.offset[0] == pytest.approx(state.position[0, 0], abs=1e-4)
    assert readings.lean[0] < 0


def test_height_of_a_rocket_with_feet_is_that_of_the_lower_one() -> None:
    world = worlds.make('rocket_planar', 1, 0, level=4)
    readings = read(world.spec, world.observe()[0])
    lean = math.radians(readings.tilt)
    assert readings.height == pytest.approx(
        200.0 - 6.7 * math.sin(lean) - 5.2 * math.cos(lean), abs=1e-3)


def test_brake_against_constant_deceleration_and_the_rocket_itself(
        rocket: SimulatedWorld) -> None:
    constant = Brake(20.0, 0.0, 1.0, 10.0)
    assert constant.time(30.0, 1.0) == 3.0
    assert constant.height(30.0, 1.0) == 45.0
    assert constant.touchdown_speed(25.0, 30.0, 1.0) == pytest.approx(20.0)
    assert constant.touchdown_speed(46.0, 30.0, 1.0) == 0.0
    # From 90 m at rest with equal fall and braking: half of it is fallen, 3 s.
    assert constant.wait(90.0, 0.0, 1.0) == pytest.approx(3.0)
    assert constant.wait(44.0, 30.0, 1.0) == 0.0
    assert constant.height(-1.0, 1.0) == 0.0
    assert Brake(9.0, 0.0, 1.0, 10.0).height(1.0, 1.0) == math.inf
    # The share that 100, 200 and 300 kg of fuel take; by small steps of the equations.
    short = Brake.of(rocket.spec)
    for fuel, hit in ((0, math.sqrt(30**2 + 2 * 9.81 * 60)), (100, 37.543), (200, 30.213),
                      (300, 24.159)):
        assert short.touchdown_speed(60.0, 30.0, short.dry_mass + fuel) == pytest.approx(
            hit, abs=1e-3)
    # Without air the closed form is the simulation's limit for small steps.
    world = worlds.make('rocket', 1, 0, air_density=0.0, dt=0.001, spawn_height=390.0,
                        spawn_angle=0.0, spawn_position=0.0, spawn_speed=0.0)
    brake = Brake.of(world.spec)
    for _ in range(2000):
        world.step(np.array([[-1.0, 0, 0]]))
    speed, begin = -world.velocity[1, 0], world.position[1, 0]
    steps = 0
    while world.velocity[1, 0] < 0:
        world.step(np.array([[1.0, 0, 0]]))
        steps += 1
    assert brake.time(speed, 24_000.0) == pytest.approx(0.001 * steps, abs=0.002)
    assert brake.height(speed, 24_000.0) == pytest.approx(begin - world.position[1, 0], abs=0.03)
    assert Brake.of(rocket.spec).height(200.0, 24_000.0) == math.inf  # no fuel for that


def test_the_watch_reports_how_late_full_throttle_came() -> None:
    brake = Brake(20.0, 0.0, 1.0, 10.0)
    watch = Watch()
    for step in range(351):
        time = 0.01 * step
        readings = Readings(
            90.0 - 5.0 * time**2, -10.0 * time, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), 0.0)
        watch.see(time, readings, brake, 1.0, float(step >= 320))
    assert watch.last_chance == pytest.approx(3.0, abs=0.011)
    assert watch.lit == pytest.approx(3.2)
    # 38.8 m left at 32 m/s: v^2 = 32^2 - 2 * 10 * 38.8.
    assert watch.hit == pytest.approx(math.sqrt(1024 - 776), abs=1e-6)
    assert '16 m/s' in watch.verdict()


def flown(world: SimulatedWorld, seed: int, **settings: float) -> FlightSummary | None:
    """Return the result of the expert."""
    expert = ExpertFlight(world.spec, seed, **settings)
    while not expert.go_on(100):
        assert expert.flight is None
    return expert.flight


def test_expert_flies_from_the_same_start() -> None:
    many = worlds.make('rocket', 3, 0)
    flight = flown(many, 4, level=7)
    pilot = ExpertPilot(many.spec)
    observation = many.reset(4, level=7)
    while True:
        observation, _, _, _, info = many.step(pilot(observation))
        if 0 in info['final_rows']:
            row = int(np.flatnonzero(info['episodes'].row == 0)[0])
            assert flight == FlightSummary.of(info['episodes'], row, many.spec)
            break
    assert flight.landed
    assert flight.episode_return > 290.0
    lander = worlds.make('lunar_lander', 1, 0, continuous=True)
    assert flown(lander, 1) is not None
    assert flown(worlds.make('rocket', 1, 0, max_thrust=1000.0), 4) is None


# Commands

def test_commands_are_separated_from_controls_and_returned_once(rocket: SimulatedWorld) -> None:
    pilot = KeyboardPilot(rocket.spec)
    commands = KeyboardCommands(pilot)
    assert commands.take(b'4\x1b[Cr', 0.0) == ['next']
    assert pilot.throttle(0.1) == 0.4
    assert pilot.sideways(0.1) == (1, 0)
    held = [commands.take(b'r', 0.5 + k / 30) for k in range(30)]
    assert not any(held)
    assert commands.take(b'rtq?\r', 3.0) == ['next', 'again', 'quit', 'help', 'next']
    assert commands.take(b'\x1b[?11u\x1b[32;1:1u', 4.0) == []
    assert pilot.throttle(100.0) == 1.0  # until it is let go, as this terminal will tell
    assert commands.take(b'\x1b[32;1:3u\x1b[113;1:3u', 101.0) == []
    assert pilot.throttle(101.0) == 0.4


# Landing by keys

class Fingers:
    """A pilot as slow as a person: looks now and then, presses four keys a second, one by one."""

    PERIOD = 0.25

    def __init__(self, world: SimulatedWorld, pilot: KeyboardPilot) -> None:
        self.world, self.pilot = world, pilot
        self.brake = Brake.of(world.spec)
        self.due = 0.0
        self.pressed = 0

    def look(self, observation: np.ndarray, mass: float, now: float) -> None:
        """Press a key, if it is time to and another throttle is wanted."""
        if now < self.due:
            return
        seen = read(self.world.spec, observation[0])
        net = self.brake.thrust / mass - self.brake.gravity
        # Begins to brake 25 m early, and comes down along a slower parabola, at 2 m/s at last.
        wanted = math.sqrt(4.0 + 2 * 0.6 * net * max(seen.height - 2.0, 0.0))
        if -seen.climb < wanted - 1.0 and seen.height > 110.0:
            return
        lift = self.brake.gravity + 0.6 * net + 1.2 * (-seen.climb - wanted)
        if seen.height < 3.0:
            lift = self.brake.gravity + 1.2 * (-seen.climb - 1.5)
        tenth = round(min(max(10 * lift * mass / self.brake.thrust, 0.0), 10.0))
        key = 'z' if tenth == 10 else str(tenth)
        if self.pilot.throttle(now) != tenth / 10:
            self.pilot.press(KeyEvent(key), now)
            self.pressed += 1
            self.due = now + self.PERIOD


@pytest.mark.parametrize('seed', range(5))
def test_level_1_can_be_landed_with_a_few_keys(rocket: SimulatedWorld, seed: int) -> None:
    pilot = KeyboardPilot(rocket.spec)
    fingers = Fingers(rocket, pilot)
    observation = rocket.reset(seed, level=1)
    for step in range(1500):
        now = rocket.spec.dt * step
        mass = float(rocket.telemetry(np.array([0])).mass[0])
        fingers.look(observation, mass, now)
        observation, _, terminated, _, info = rocket.step(pilot.act(observation, now))
        if terminated[0]:
            break
    episodes = info['episodes']
    assert rocket.spec.outcomes[episodes.outcome[0]] == 'landed', episodes
    assert fingers.pressed < 40
    assert episodes.touchdown_speed[0] < 3.0
