# SPDX-License-Identifier: Apache-2.0
"""The ingredients of preset `default`, changed one at a time, in trainings of reduced size."""
from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from benchmarks.experiments.training import Recipe

ROCKETS, QUICK_ROCKETS = 128, 32
SCALE: Mapping[str, object] = {
    'demonstration_episodes': 128, 'dagger_rounds': 4, 'dagger_epochs': 3, 'clone_epochs': 4,
    'hidden_sizes': (64, 64), 'iterations': 24, 'selection_interval': 1000,
    'selection_episodes': 128, 'checkpoint_interval': 1000}
"""Settings of the base that differ from `default`, so that three seeds take half an hour."""
QUICK: Mapping[str, object] = {
    'demonstration_episodes': 8, 'dagger_rounds': 1, 'dagger_epochs': 1, 'clone_epochs': 1,
    'iterations': 1, 'scatter_steps': 8, 'selection_episodes': 8}
IMITATION, PPO = 'imitation', 'PPO'
CRITIC: Mapping[str, object] = {
    'start_copies': 1, 'n_steps': 128, 'batch_size': 4096, 'n_epochs': 2, 'gamma': 1.0,
    'gae_lambda': 0.99, 'critic_warmup_iterations': 4}
"""Settings for advantages from a critic, with fewer samples per roll-out."""


class Variant(NamedTuple):
    """An ingredient that is changed or left out."""

    name: str
    stage: str
    """The stage that it belongs to; variants of PPO do not change the clone."""
    overrides: Mapping[str, object]
    asks: str


BASE = Variant('base', IMITATION, {}, 'what the others are compared with')
VARIANTS = (
    Variant('gentle teacher', IMITATION, {
        'teacher_braking_share': 0.8, 'teacher_flare_rate': 3.0, 'teacher_flare_speed': 0.1,
        'teacher_speed_settling': 0.05, 'teacher_attitude_rate': 24.0},
        'whether a teacher that is easier to imitate makes a better pupil'),
    Variant('no features', IMITATION, {'features': 'none', 'fine_observations': 'pad_y'},
            'what seeing quotients is worth'),
    Variant('features: guidance', IMITATION, {'features': 'guidance'},
            'whether features of guidance help where there is a teacher'),
    Variant('no DAgger', IMITATION, {'dagger_rounds': 0},
            'what it is worth to be corrected in states of its own'),
    Variant('1 round of DAgger', IMITATION, {'dagger_rounds': 1}, 'whether one round is enough'),
    Variant('no noise', IMITATION, {'demonstration_noise': 0.0},
            'what disturbed demonstrations are worth'),
    Variant('near the ground', IMITATION, {'demonstration_spawn_reach': 194.8},
            'whether half of the demonstrations should begin at all heights'),
    Variant('squared loss', IMITATION, {'clone_huber_delta': 0.0},
            'what it is worth not to square large errors'),
    Variant('no level 8', IMITATION, {'curriculum_wide_level': 0},
            'what level 8 costs on level 7'),
    Variant('independent noise', PPO, {'exploration': 'independent'},
            'what noise is worth that is one function of the state'),
    Variant('last layer', PPO, {'trained_layers': 1},
            'whether the last layer has to learn alone'),
    Variant('2 copies', PPO, {'start_copies': 2}, 'more starts, each judged by fewer copies'),
    Variant('32 copies', PPO, {'start_copies': 32}, 'fewer starts, each judged by more copies'),
    Variant('critic', PPO, CRITIC, 'what copies are worth: the critic judges, with GAE'),
    Variant('critic, no warm-up', PPO, {**CRITIC, 'critic_warmup_iterations': 0},
            'what waiting for the critic is worth'),
    Variant('critic, gamma 0.99', PPO, {**CRITIC, 'gamma': 0.99},
            'a usual discount: 2 s ahead'),
    Variant('critic, lambda 0.95', PPO, {**CRITIC, 'gae_lambda': 0.95},
            'a usual lambda: 0.4 s ahead'),
    Variant('fixed rate', PPO, {'desired_kl': 0.0}, 'what adapting the rate is worth'),
    Variant('clip 0.05', PPO, {'clip_range': 0.05}, 'shorter steps away from the old policy'),
    Variant('deviation 0.05', PPO, {'log_std_init': -3.0, 'log_std_final': -3.0},
            'more noise to explore with, to the end'),
    Variant('deviation 0.001', PPO, {'log_std_init': -7.0, 'log_std_final': -7.0},
            'hardly any noise'),
    Variant('from level 1', PPO, {'curriculum_start_level': 1},
            'what a curriculum is worth after a clone that lands'),
    Variant('batch 65 536', PPO, {'batch_size': 65536}, 'an eighth of the steps of Adam'),
)


def recipe(variant: Variant, quick: bool = False) -> Recipe:
    """Return the recipe of a variant; a quick one has too few iterations for a warm-up."""
    scale = {**SCALE, **(QUICK if quick else {})}
    kept = {name: value for name, value in variant.overrides.items()
            if not quick or name not in ('dagger_rounds', 'critic_warmup_iterations')}
    name = ''.join(letter if letter.isalnum() or letter in '.' else '-' for letter in variant.name)
    return Recipe(
        f'ingredients-{name}', 'default', {**scale, **kept}, QUICK_ROCKETS if quick else ROCKETS)
