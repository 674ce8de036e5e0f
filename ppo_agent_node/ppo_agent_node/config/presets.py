# SPDX-License-Identifier: Apache-2.0
"""Presets: named files of settings, separate for each world."""
from __future__ import annotations

from importlib import resources
from typing import Any

import yaml

from ppo_agent_node.config.training_config import Config
from ppo_agent_node.config.training_config import make_config

_LOADER: Any = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
"""The safe loader; with libyaml, one that is ten times as fast."""
_PRESETS = resources.files('ppo_agent_node') / 'presets'
DEFAULT = 'default'
"""Preset of a run that names none."""
_NUM_ENVS = {
    ('lunar_lander', 'default'): 128, ('lunar_lander', 'from_scratch'): 100,
    ('lunar_lander', 'original'): 8, ('lunar_lander', 'quick'): 128}
"""Number of vehicles of presets that do not have the usual 256, by world and name."""


def preset_names(world: str | None = None) -> tuple[str, ...]:
    """Return the names of the built-in presets of a world, or of all worlds."""
    return tuple(sorted({
        preset.name.removesuffix('.yaml') for folder in _PRESETS.iterdir()
        if folder.is_dir() and world in (None, folder.name)
        for preset in folder.iterdir() if preset.name.endswith('.yaml')}))


def preset_values(name: str, world: str) -> dict[str, Any]:
    """Return the unchecked values of a world's preset, by name.

    Presets are files `presets/<world>/<name>.yaml`. The key `like` names a preset whose values are
    applied first: either a world, whose preset of the same name is meant, or a world and a name,
    as in `rocket/from_scratch`.

    :raises ValueError: if there is no such preset.
    """
    known = preset_names(world)
    if name not in known:
        raise ValueError(
            f'unknown preset {name!r} of world {world!r}, '
            f'expected one of {", ".join(known) or "none"}')
    values = dict(yaml.load((_PRESETS / world / f'{name}.yaml').read_text('utf-8'), _LOADER))
    like = values.pop('like', None)
    if not like:
        return values
    world, _, other = like.partition('/')
    return {**preset_values(other or name, world), **values}


def preset_num_envs(name: str, world: str) -> int:
    """Return the number of vehicles for which a world's preset was made."""
    return _NUM_ENVS.get((world, name), 256)


def load_preset(name: str, world: str = 'rocket', **overrides: object) -> Config:
    """Return the settings of a world's preset, with some values overridden.

    :raises ValueError: for an unknown preset or setting, or a value out of range.
    :raises TypeError: for a value of the wrong type.
    """
    return make_config({**preset_values(name, world), **overrides})
