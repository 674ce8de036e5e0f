# SPDX-License-Identifier: Apache-2.0
"""The pilot of an engine that cannot hover: its curve, its last steps, and that it lands."""
from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ppo_agent_node.config.imitation_config import DemonstrationConfig
from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.evaluation.metrics import summarise
from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.pilots.estimator.estimator import ExpertEstimator
from ppo_agent_node.pilots.expert.braking import BrakingProfile
from ppo_agent_node.pilots.expert.braking import last_steps
from ppo_agent_node.pilots.expert.expert import ExpertPilot
from ppo_agent_node.pilots.expert.hoverslam import HoverslamPilot
from ppo_agent_node.pilots.scripted import for_vehicle
from ppo_agent_node.pilots.scripted import scripted_pilot
from ppo_agent_node.pilots.teacher import scripted_teacher
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.training.trainer import Trainer
from rocket_sim_node import worlds
from rocket_sim_node.worlds.jobs import SerialFleet
from rocket_sim_node.worlds.rocket import conditions

ROWS = 300
PROFILE = BrakingProfile(
    braking=8.0, last_braking=6.0, join_speed=2.0, touchdown_speed=0.02, gravity=9.81,
    least_braking=2.5)


def _fly(level: int, seed: int = 11, **settings: Any) -> dict[str, Any]:
    world = worlds.make('rocket', ROWS, conditions='hoverslam', **settings)
    return summarise(evaluate(world, scripted_pilot(world.spec), ROWS, seed, level=level))


def test_lands_an_engine_that_cannot_hover() -> None:
    summary = _fly(7)
    assert summary['landed'] == ROWS, summary['outcomes']
    assert summary['mean_return'] > 294.4
    assert summary['touchdown_speed']['p95'] < 0.03
    assert summary['fuel_ratio'] < 1.15


@pytest.mark.slow
def test_lands_from_far_off_the_axis() -> None:
    summary = _fly(8)
    assert summary['landed'] > 0.94 * ROWS, summary['outcomes']


def test_lands_with_unknown_errors_in_mass_and_thrust() -> None:
    summary = _fly(7, dry_mass_factor=(0.97, 1.03), thrust_factor=(0.97, 1.03))
    assert summary['landed'] == ROWS, summary['outcomes']
    assert summary['mean_return'] > 292.5


def test_lands_in_the_plane() -> None:
    world = worlds.make('rocket_planar', 100, conditions='hoverslam')
    flown = evaluate(world, scripted_pilot(world.spec), 100, 11, level=7)
    assert summarise(flown)['landed'] == 100


def test_the_pilot_is_chosen_for_engines_with_a_floor() -> None:
    floored = worlds.make('rocket', conditions='hoverslam').spec
    nominal = worlds.make('rocket').spec
    config = DemonstrationConfig()
    assert isinstance(scripted_pilot(floored), HoverslamPilot)
    assert isinstance(scripted_teacher(floored, config), HoverslamPilot)
    for pilot in (scripted_pilot(nominal), scripted_teacher(nominal, config)):
        assert type(pilot) is ExpertPilot


@pytest.mark.parametrize(('plain', 'wide'), [('', 'hoverslam'), ('hoverslam', 'mix')])
def test_demonstrations_by_another_pilot_at_the_wide_level_are_refused(
        tmp_path: Path, plain: str, wide: str) -> None:
    """One teacher labels the flights of both groups."""
    def trainer(**changes: object) -> Trainer:
        config = load_preset('default', 'rocket', **{
            'conditions': plain, 'curriculum_wide_conditions': wide, **changes})
        return Trainer(SerialFleet(worlds.make('rocket', 16)), config, RunFolder(
            tmp_path / str(len(list(tmp_path.iterdir())))))

    with pytest.raises(ValueError, match=r"^teacher: got '', expected the name of one pilot for"):
        trainer()
    trainer(teacher='hoverslam')
    trainer(curriculum_wide_conditions=plain)
    trainer(demonstration_episodes=0)


def test_the_engine_lights_once_and_burns_at_the_floor_or_more() -> None:
    world = worlds.make('rocket', 50, seed=3, conditions='hoverslam', level=7)
    pilot = scripted_pilot(world.spec)
    observation, burning = world.observe(), []
    for _ in range(440):
        action = pilot(observation)
        burning.append((action[:, 0] + 1) / 2)
        observation, *_ = world.step(action)
    throttle = np.array(burning)
    on = throttle > 0
    assert (np.diff(on.astype(int), axis=0) >= 0).all()
    assert on[-1].all()
    assert not on[0].any()
    assert throttle[on].min() >= 0.6 - 1e-6


def test_a_new_pilot_detects_whether_the_engine_burns() -> None:
    """It does so at its first look at a flight, since the rocket has braked."""
    world = worlds.make('rocket', 20, seed=3, conditions='hoverslam', level=4)
    pilot, observation = scripted_pilot(world.spec), world.observe()
    for step in range(400):
        action = pilot(observation)
        stranger = scripted_pilot(world.spec)(observation)
        assert ((stranger[:, 0] > -1) == (action[:, 0] > -1)).all(), step
        observation, *_ = world.step(action)


@pytest.mark.parametrize('height', [0.05, 0.3, 5.0, 80.0])
def test_one_step_along_the_curve_ends_on_it(height: float) -> None:
    speed = PROFILE.next_speed(np.array([height]), 0.02)
    assert speed == pytest.approx(PROFILE.speed(height - speed * 0.02), rel=2e-3)


def test_the_curve_is_two_parabolas() -> None:
    assert PROFILE.join_height == pytest.approx((4.0 - 0.0004) / 12)
    high = PROFILE.join_height + 10.0
    assert PROFILE.speed(np.array([high])) == pytest.approx(np.sqrt(4.0 + 160.0))
    assert PROFILE.speed(np.array([0.0])) == pytest.approx(0.02)


@pytest.mark.parametrize(('speed', 'expected'), [
    (12.0, (144.0 - 4.0) / 20.0), (10.0, (100.0 - 0.0004) / (2 * (10.0 + 3.9996 / 12.0)))])
def test_the_curve_through_a_place_leads_on_from_it(speed: float, expected: float) -> None:
    height = np.array([PROFILE.join_height + 10.0])
    found = PROFILE.through(height, np.array([speed]))
    assert found.braking == pytest.approx(expected)
    assert found.speed(height) == pytest.approx(speed)
    assert PROFILE.through(height, np.array([40.0])).braking == PROFILE.braking
    assert PROFILE.through(height, np.array([0.0])).braking == PROFILE.least_braking


def test_time_to_go_is_that_of_flying_it() -> None:
    height, speed, dt, elapsed = np.array([150.0]), np.array([3.0]), 1e-3, 0.0
    expected = PROFILE.time_to_go(height, speed)
    while height[0] > 0:
        wanted = PROFILE.next_speed(height, dt)
        speed = np.where(speed + 9.81 * dt < wanted, speed + 9.81 * dt, wanted)
        height = height - speed * dt
        elapsed += dt
    assert expected.coast[0] + expected.burn[0] == pytest.approx(elapsed, abs=0.01)


@pytest.mark.parametrize(('height', 'speed'), [(0.35, 2.0), (0.3, 2.0), (0.02, 0.4), (0.36, 2.1)])
def test_the_last_steps_end_at_rest_on_the_ground(height: float, speed: float) -> None:
    """Flown as planned, all within what the engine gives, whatever the phase of the steps."""
    dt, h, v, asked = 0.02, height, speed, []
    while h > 1e-9 and len(asked) < 100:
        asked.append(last_steps(np.array([h]), np.array([v]), 0.005, dt)[0])
        v -= asked[-1] * dt
        h -= v * dt
    assert h == pytest.approx(0.0, abs=1e-9)
    assert v == pytest.approx(0.005, abs=1e-9)
    assert 2.3 < min(asked) <= max(asked) < 10.5


def test_two_steps_are_the_closed_form() -> None:
    """v1 + v2 = h / dt and v2 = v0 leave no choice."""
    dt, height, speed = 0.02, 0.0024, 0.25
    first = speed - last_steps(np.array([height]), np.array([speed]), 0.01, dt)[0] * dt
    assert first == pytest.approx(height / dt - 0.01)


def test_the_pilot_replaces_the_expert_for_engines_with_a_floor() -> None:
    spec = worlds.make('rocket').spec
    floor = spec.after_reset(conditions.settings('hoverslam'))
    expert, estimator = ExpertPilot(spec), ExpertEstimator(spec)
    assert type(for_vehicle(expert, floor)) is HoverslamPilot
    assert for_vehicle(expert, spec) is expert
    assert for_vehicle(estimator, floor) is estimator
    tuned = ExpertPilot(spec, flare_rate=20.0)
    assert for_vehicle(tuned, floor) is tuned
