# SPDX-License-Identifier: Apache-2.0
"""The keyboard pilot survives any description of a world, or reports what is wrong."""
from __future__ import annotations

import copy
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings
from hypothesis import strategies as st
from rocket_msgs import msg
from support.invalid_data.fuzzing import ANY_F32
from support.invalid_data.fuzzing import ANY_FLOAT
from test_properties_recorder import WORLDS
from test_properties_recorder import good
from test_properties_recorder import harmed

from ppo_agent_node.cockpit.display import Cockpit
from ppo_agent_node.cockpit.instruments import Brake
from ppo_agent_node.nodes.flights.hand_flying import EpisodeStart
from ppo_agent_node.nodes.flights.hand_flying import HandFlying
from ppo_agent_node.pilots.keyboard import KeyboardPilot
from rocket_sim_node import worlds
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.worlds import EnvironmentRestarted
from rocket_sim_node.worlds import Episodes
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.base import NO_EPISODES
from rocket_sim_node.worlds.rocket import conditions

SESSION = 1
FINITE_F32 = ANY_F32.filter(math.isfinite)
SOME = settings(max_examples=max(30, settings.default.max_examples // 2))


class Hands:
    """A hand pilot at a terminal that shows nothing, without DDS.

    It is its own node, client and terminal. A flight ends with the last observation, or is lost.
    """

    session, realtime = SESSION, True

    def __init__(self, spec: WorldSpec) -> None:
        self.spec, self.said, self.heard = spec, list[str](), list[Any]()
        self.seen: list[Any] = []
        self.lines: list[str] = []
        this: Any = self
        self.flying = HandFlying(
            this, this, this, Cockpit(), KeyboardPilot(spec), EpisodeStart(1, 0), '')

    def fly(self, seen: list[Any], heard: list[Any], lands: bool = False) -> None:
        """Fly through some observations, with a message before each of them."""
        self.seen, self.heard, self._lands = list(seen), list(heard), lands
        self.flying._fly(EpisodeStart(1, 0))

    # The node

    def create_subscription(self, *_: Any) -> None:
        pass

    def get_logger(self) -> Any:
        return self

    def warning(self, text: str, **_: Any) -> None:
        self.said.append(text)

    # The client

    def reset(self, seed: int, **_: float) -> Any:
        return self.seen[0]

    def step(self, action: Any) -> Any:
        if not self.seen:
            raise EnvironmentRestarted('the flight is over')
        seen = self.seen.pop(0)
        if self.heard:
            self.flying._on_state(self.heard.pop(0))
        self.flying._drawn = 0.0  # each step is shown
        done = np.arange(int(self._lands and not self.seen))
        one = np.ones(1)
        episodes = Episodes(
            done, done, one, done, done.astype(np.uint8), one, one, one, one, one, one, done, one)
        return seen, one, one > 0, one > 0, {
            'final_rows': done, 'final_observation': seen,
            'episodes': episodes if len(done) else NO_EPISODES}

    def close(self) -> None:
        pass

    # The terminal

    def read(self, seconds: float) -> bytes:
        return b''

    def errors(self) -> list[str]:
        return []

    def draw(self, lines: list[str]) -> None:
        self.lines = lines


def observations(spec: WorldSpec) -> st.SearchStrategy[list[Any]]:
    """Return flights of possible observations: any finite numbers."""
    row = st.lists(
        st.one_of(st.floats(-5.0, 5.0, width=32), FINITE_F32), min_size=spec.observation_size,
        max_size=spec.observation_size)
    return st.lists(row.map(lambda row: np.float32([row])), min_size=1, max_size=3)


@pytest.mark.parametrize('world', WORLDS)
@SOME
@given(data=st.data())
def test_invalid_states_do_not_end_a_flight_by_hand(world: str, data: Any) -> None:
    said, *states, _ = good(world, SESSION)
    spec = conversion.world_from_message(said)
    hands = Hands(spec)
    first, *others = states
    rubbish = [data.draw(harmed(state)) for state in others]
    hands.fly(data.draw(observations(spec)) * len(rubbish), rubbish)
    hands.flying._on_state(first)
    tank, last = hands.flying._tank, max(
        k for k in range(len(first.row)) if not first.row[k] and not first.episode[k])
    for name in ('mass', 'fuel', 'throttle', 'time'):
        assert getattr(tank, name) == getattr(first, name)[last]
    assert all(text.startswith('state ignored: ') for text in hands.said)


@pytest.mark.parametrize(('harm', 'said'), [
    ({'mass': [0.0]}, 'mass: got 0, expected 22000 to 24000'),
    ({'mass': [1e9]}, 'mass: got 1e+09, expected 22000 to 24000'),
    ({'mass': []}, 'mass: 0 values, expected 1'),
    ({'fuel': [-1.0]}, 'fuel: got -1, expected 0 to 2000'),
    ({'throttle': [2.0]}, 'throttle: got 2, expected 0 to 1'),
    ({'time': [math.nan]}, 'time: a value is not finite'),
    ({'row': [0, 0]}, 'row: 2 values, expected 1'),
])
def test_an_impossible_state_is_ignored_with_a_reason(
        harm: dict[str, Any], said: str) -> None:
    world = worlds.make('rocket')
    hands = Hands(world.spec)
    full = hands.flying._tank
    message = conversion.state_to_message(
        np.zeros(1, np.uint64), world.telemetry(slice(None)), SESSION)
    for name, values in harm.items():
        setattr(message, name, values)
    hands.fly([world.observe()], [message])
    assert hands.flying._tank == full
    assert len(hands.said) == 1
    assert f'state ignored: {said}' in hands.said[0]


@pytest.mark.parametrize('chosen', [
    {'conditions': 'harsh'}, {'conditions': 'mix'}, {'dry_mass_factor': 0.7, 'fuel_factor': 1.3},
    {'dry_mass_factor': 1.2, 'fuel_factor': 0.5}])
def test_the_state_of_a_drawn_vehicle_is_shown(chosen: dict[str, Any]) -> None:
    """Its mass and fuel are outside those of the nominal vehicle."""
    world = worlds.make('rocket', 1, **conditions.flatten(chosen))
    hands = Hands(world.spec)
    for seed in range(20):
        seen = world.reset(seed)
        drawn = dict(zip(conditions.DRAWN_NAMES, world.vehicles.drawn[:, 0], strict=True))
        hands.fly([seen], [conversion.state_to_message(
            np.zeros(1, np.uint64), world.telemetry(slice(None)), SESSION)])
        tank = hands.flying._tank
        assert tank.brake.dry_mass == pytest.approx(22_000 * drawn['dry_mass_factor'])
        assert tank.fuel == pytest.approx(2_000 * drawn['fuel_factor'])
        assert tank.mass == pytest.approx(tank.brake.dry_mass + tank.fuel)
    assert not hands.said


def test_a_light_rocket_can_brake_as_long_as_it_has_fuel() -> None:
    """One of 0.8 times the nominal dry mass, in the debriefing and on the instruments."""
    world = worlds.make('rocket', 1, dry_mass_factor_low=0.8, dry_mass_factor_high=0.8)
    hands = Hands(world.spec)
    falls = np.zeros((1, 15), np.float32)
    falls[0, [4, 7, 13]] = -1.0, 1.0, -1.0  # downwards, upright, above the pad
    message = conversion.state_to_message(
        np.zeros(1, np.uint64), world.telemetry(slice(None)), SESSION)
    hands.fly([falls] * 3, [message], lands=True)
    assert hands.flying._tank.mass == pytest.approx(0.8 * 22_000 + 2_000)
    assert hands.flying._flown[1].last_chance is None
    assert not any('never' in line for line in hands.lines)


@st.composite
def described(draw: Any, world: str) -> msg.World:
    """A good world with any settings of the right kind and range, or with something wrong."""
    message = copy.deepcopy(good(world, SESSION)[0])
    infos = {info.name: info for info in worlds.settings(world)}
    infos.setdefault('max_thrust', next(
        info for info in worlds.settings('rocket') if info.name == 'max_thrust'))
    for item in draw(st.lists(st.sampled_from(message.settings), max_size=8)):
        info = infos.get(item.name)
        if info is None or isinstance(info.default, bool):
            item.value = draw(st.sampled_from([0.0, 1.0]))
        elif isinstance(info.default, int):
            item.value = float(draw(st.integers(int(info.low), int(info.high))))
        else:
            near = st.sampled_from([info.low, math.nextafter(info.low, math.inf), info.high])
            item.value = draw(st.one_of(near, st.floats(info.low, info.high)))
    wrong = draw(st.sampled_from(['', '', '', 'harmed', 'missing', 'other']))
    if wrong == 'harmed':
        return draw(harmed(message))
    if wrong == 'missing':
        message.settings = draw(st.lists(st.sampled_from(message.settings), unique_by=id))
    if wrong == 'other':
        message.settings = [*message.settings, *(
            msg.Setting(name=name, value=draw(ANY_FLOAT)) for name in (
                'stance', 'fuel', 'level', 'spawn_height', 'landed_speed')
            if name not in infos)]
    return message


@pytest.mark.parametrize('world', WORLDS)
@SOME
@given(data=st.data())
def test_any_world_is_flown_by_hand_or_refused_with_a_reason(world: str, data: Any) -> None:
    try:
        spec = conversion.world_from_message(data.draw(described(world)))
        hands = Hands(spec)
    except ValueError as error:
        assert 'expected' in str(error) or 'twice' in str(error)
        assert str(error).isprintable()
        return
    hands.fly(data.draw(observations(spec)), [], lands=True)
    for _ in range(3):
        hands.flying._let_the_expert_fly()


@pytest.mark.parametrize('chosen', [
    {'spawn_height': 5.2}, {'gravity': 5e-324}, {'max_thrust': 1e-178, 'gravity': 0.0},
    {'max_thrust': 1e-311}])
def test_vehicles_at_the_ends_of_the_ranges_are_flown(chosen: dict[str, float]) -> None:
    spec = worlds.make('rocket').spec
    hands = Hands(replace(spec, settings={**spec.settings, **chosen}))
    falls = np.zeros((1, 15), np.float32)
    falls[0, [4, 7, 13]] = -1.0, 1.0, -1.0  # downwards, upright, above the pad
    hands.fly([falls] * 2, [], lands=True)
    while hands.flying._expert is not None:
        hands.flying._let_the_expert_fly()
    assert hands.flying.summary().startswith('landed 1 of 1')


@pytest.mark.parametrize('world', WORLDS)
def test_each_setting_that_is_missing_is_named(world: str) -> None:
    message = good(world, SESSION)[0]
    needed = {info.name for info in worlds.settings(world)} | {'max_thrust'}
    for name in needed:
        shorter = copy.deepcopy(message)
        shorter.settings = [item for item in message.settings if item.name != name]
        spec = conversion.world_from_message(shorter)
        with pytest.raises(ValueError, match=f'^world: settings: {name}: got None, expected'):
            Brake.of(spec)
        with pytest.raises(ValueError, match=f'^world: settings: {name}: got None, expected'):
            Hands(spec)
