# SPDX-License-Identifier: Apache-2.0
"""Presets, each for its world."""
from __future__ import annotations

import pytest

from ppo_agent_node.config import presets
from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.config.presets import preset_names
from ppo_agent_node.config.presets import preset_values
from ppo_agent_node.config.training_config import check_world
from ppo_agent_node.pilots.expert.hoverslam import HoverslamPilot
from ppo_agent_node.pilots.teacher import scripted_teacher
from rocket_sim_node import worlds
from rocket_sim_node.worlds.rocket import conditions


@pytest.mark.parametrize('world', worlds.names())
def test_every_world_has_a_default_and_all_presets_are_good(world: str) -> None:
    assert 'default' in preset_names(world)
    for name in preset_names(world):
        levels = load_preset(name, world).curriculum.curriculum_final_level > 0
        assert levels == ('level' in {info.name for info in worlds.settings(world)})
    assert set(preset_names(world)) <= set(preset_names())


def test_the_original_of_the_rocket() -> None:
    original = load_preset('original')
    assert original.ppo.clip_range == 0.05
    assert original.ppo.gamma == 0.99
    assert original.ppo.gae_lambda == 0.95
    assert original.ppo.n_steps == 2048
    assert original.ppo.n_epochs == 2
    assert original.ppo.batch_size == 64
    assert original.ppo.actor_learning_rate == 3e-5
    assert original.ppo.critic_learning_rate == 1e-4
    assert original.ppo.entropy_coefficient == 0.01
    assert original.network.log_std_floor == -2.5
    assert original.network.hidden_sizes == (256, 256)


def test_the_original_of_the_lunar_lander() -> None:
    original = load_preset('original', 'lunar_lander')
    assert original.network.hidden_sizes == (512, 256, 64)
    assert original.network.activation == 'relu'
    ppo = original.ppo
    assert (ppo.clip_range, ppo.value_clip_range) == (0.2, 0.2)
    assert (ppo.gamma, ppo.gae_lambda, ppo.entropy_coefficient) == (0.99, 0.9, 0.001)
    assert ppo.actor_learning_rate == ppo.critic_learning_rate == 2.5e-4
    assert not ppo.learning_rate_decay
    assert (ppo.n_steps * 8, ppo.n_epochs, ppo.batch_size) == (1000, 10, 32)
    assert original.demonstration.demonstration_episodes == 0
    assert original.run.episode_lines
    assert original.run.training_episodes == 10_000
    assert original.run.evaluation_episodes == 500
    # 1 000 steps are the most that an episode has.
    assert ppo.iterations * ppo.n_steps * 8 >= 1000 * original.run.training_episodes


def test_the_hoverslam_learns_with_the_engine_that_cannot_hover() -> None:
    """In all that it flies: demonstrations, roll-outs and selection."""
    preset = load_preset('hoverslam')
    floored = conditions.settings('hoverslam')
    assert (floored['throttle_floor_low'], floored['ignitions']) == (0.6, 1)
    curriculum = preset.curriculum
    flown = (*curriculum.selection_settings, *(
        curriculum.reset_settings(7, group) for group in range(preset.ppo.num_groups)))
    assert all(settings == {**floored, 'level': 7} for settings in flown)
    # Noise about the command that keeps the engine off would light it.
    assert preset.demonstration.demonstration_noise == 0
    world = worlds.make('rocket', observation='extended').spec
    check_world(preset, world)
    assert isinstance(scripted_teacher(
        world.after_reset(curriculum.task_settings(0)), preset.demonstration), HoverslamPilot)


def test_presets_of_a_world_can_extend_those_of_another(
        tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    planar = {
        'actor_learning_rate', 'clip_range', 'curriculum_heading', 'dagger_rounds',
        'demonstration_spawn_heading', 'desired_kl', 'iterations', 'n_epochs', 'target_kl',
        'teacher_flare_rate', 'teacher_flare_speed', 'teacher_least_settling'}
    for name, own in (('default', planar), ('original', set())):
        values, taken = preset_values(name, 'rocket_planar'), preset_values(name, 'rocket')
        assert {name for name in values if values[name] != taken.get(name)} == own
    for world, text in (('one', 'gamma: 0.5\nn_steps: 7\n'), ('two', 'like: one\nn_steps: 9\n')):
        (tmp_path / world).mkdir()
        (tmp_path / world / 'default.yaml').write_text(text)
    monkeypatch.setattr(presets, '_PRESETS', tmp_path)
    assert preset_values('default', 'two') == {'gamma': 0.5, 'n_steps': 9}
    assert load_preset('default', 'two').ppo.gamma == 0.5


def test_unknown_presets_are_named() -> None:
    assert preset_names() == (
        'default', 'from_scratch', 'hoverslam', 'original', 'quick', 'robust')
    assert load_preset('default', seed=9).run.seed == 9
    with pytest.raises(ValueError, match=(
            "unknown preset 'fast' of world 'rocket', expected one of default, from_scratch, "
            'hoverslam, original, quick, robust')):
        load_preset('fast')
    with pytest.raises(ValueError, match="'default' of world 'mars', expected one of none"):
        load_preset('default', 'mars')


def test_levels_are_for_worlds_that_have_them() -> None:
    no_levels = {'curriculum_start_level': 0, 'curriculum_final_level': 0}
    with pytest.raises(ValueError, match='curriculum_final_level: got 0, expected 1 or more'):
        check_world(load_preset('default', 'rocket', **no_levels), worlds.make('rocket').spec)
    lander = worlds.make('lunar_lander').spec
    check_world(load_preset('default', 'lunar_lander'), lander)
    with pytest.raises(ValueError, match='curriculum_final_level: got 7, expected 0'):
        check_world(load_preset('default', 'rocket'), lander)


@pytest.mark.parametrize('world', ['rocket', 'lunar_lander'])
def test_a_simulator_with_easy_starts_is_refused(world: str) -> None:
    """Otherwise selections and evaluations would fly them as well."""
    config = load_preset('default', world)
    check_world(config, worlds.make(world, spawn_reach=0.0).spec)
    with pytest.raises(ValueError, match=(
            r'^spawn_reach: got 0\.5, expected 0, as a training sets it by '
            r'curriculum_start_reach$')):
        check_world(config, worlds.make(world, spawn_reach=0.5).spec)


@pytest.mark.parametrize('name', ['conditions', 'curriculum_wide_conditions'])
def test_conditions_are_for_worlds_that_have_them(name: str) -> None:
    asked = load_preset('default', 'lunar_lander', **{name: 'harsh'})
    with pytest.raises(ValueError, match=(
            f"^{name}: got 'harsh', expected none, as world 'lunar_lander' has no conditions$")):
        check_world(asked, worlds.make('lunar_lander').spec)
    check_world(load_preset('default', 'rocket', **{name: 'harsh'}), worlds.make('rocket').spec)


def test_conditions_of_a_wide_level_need_one() -> None:
    world = worlds.make('rocket').spec
    asked = load_preset(
        'default', 'rocket', curriculum_wide_level=0, curriculum_wide_conditions='harsh')
    with pytest.raises(ValueError, match=(
            r"^curriculum_wide_conditions: got 'harsh', expected '' with curriculum_wide_level "
            r'0$')):
        check_world(asked, world)


@pytest.mark.parametrize('name', ['gamma_first', 'entropy_coefficient_final'])
def test_only_minus_one_leaves_a_schedule_unset(name: str) -> None:
    for value in (-0.5, -1e-9, -0.999):
        with pytest.raises(ValueError, match=(
                f'^{name}: got {value:g}, expected -1, or 0 or more$')):
            load_preset('default', 'rocket', **{name: value})
    for value in (-1.0, -0.0, 0.0, 0.5):
        load_preset('default', 'rocket', **{name: value})


def test_only_rockets_have_an_extended_observation() -> None:
    asked = load_preset('default', 'lunar_lander', observation='extended')
    with pytest.raises(ValueError, match=(
            r"^observation: got 'extended', expected 'standard', as world 'lunar_lander' has ")):
        check_world(asked, worlds.make('lunar_lander').spec)


def test_the_nominal_share_applies_to_training_only() -> None:
    """Evaluation and selection fly the conditions as they are."""
    asked = load_preset(
        'robust', 'rocket', curriculum_nominal_share=0.25, selection_wide=True).curriculum
    assert asked.reset_settings(7)['nominal_share'] == 0.25
    assert asked.reset_settings(7, group=1)['nominal_share'] == 0.25
    assert asked.task_settings(7)['nominal_share'] == 0.0
    assert [task['nominal_share'] for task in asked.selection_settings] == [0.0, 0.0]
    with pytest.raises(ValueError, match=(
            r'^curriculum_nominal_share: got 0\.25, expected none, as world .lunar_lander. has no '
            r'conditions$')):
        check_world(load_preset('default', 'lunar_lander', curriculum_nominal_share=0.25),
                    worlds.make('lunar_lander').spec)


def test_headings_are_for_worlds_that_have_them() -> None:
    """Otherwise a run would end after cloning, when the world refuses the reset."""
    turned = load_preset('default', 'rocket_planar')
    assert turned.curriculum.reset_settings(3) == {'level': 3, 'spawn_heading': 180.0}
    check_world(turned, worlds.make('rocket_planar').spec)
    with pytest.raises(ValueError, match='curriculum_heading: got 180'):
        check_world(turned, worlds.make('rocket').spec)
    check_world(load_preset('default', 'rocket'), worlds.make('rocket').spec)
    asked = load_preset('default', 'rocket', demonstration_spawn_heading=90.5)
    with pytest.raises(ValueError, match='demonstration_spawn_heading: got 90'):
        check_world(asked, worlds.make('rocket').spec)
    plane = load_preset('default', 'rocket', demonstration_spawn_heading=0.0)
    with pytest.raises(ValueError, match='demonstration_spawn_heading: got 0'):
        check_world(plane, worlds.make('rocket').spec)


@pytest.mark.parametrize(('name', 'default'), [
    ('angle', 37), ('position', 8), ('speed', 3.5), ('spin', 0.05)])
def test_starts_of_demonstrations_are_for_worlds_with_levels(name: str, default: float) -> None:
    """Other worlds would ignore them."""
    setting = f'demonstration_spawn_{name}'
    lander = worlds.make('lunar_lander').spec
    with pytest.raises(ValueError, match=(
            rf"^{setting}: got 1, expected {default}, the default, as world 'lunar_lander' has no "
            r'levels$')):
        check_world(load_preset('quick', 'lunar_lander', **{setting: 1.0}), lander)
    check_world(load_preset(
        'quick', 'lunar_lander', **{setting: default}, demonstration_spawn_reach=2.0), lander)
    check_world(load_preset('default', 'rocket', **{setting: 1.0}), worlds.make('rocket').spec)
