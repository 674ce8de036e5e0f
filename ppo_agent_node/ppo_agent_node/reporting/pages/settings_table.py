# SPDX-License-Identifier: Apache-2.0
"""Table of a run's settings with descriptions and differences from a preset or default."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ppo_agent_node.config import presets
from ppo_agent_node.config import training_config
from ppo_agent_node.reporting.run_files import Run
from rocket_sim_node.settings import SettingInfo
from rocket_sim_node.worlds import registry

_UNREMARKABLE = ('seed', 'threads')
"""Settings of a run that are ignored in the search for the nearest preset."""


@dataclass(frozen=True)
class Setting:
    """One line of the table."""

    name: str
    value: str
    usual: str
    """Value of the preset or default if it differs, else ''."""
    meaning: str

    @property
    def differs(self) -> bool:
        """Whether it differs from the preset or default."""
        return bool(self.usual)


@dataclass(frozen=True)
class Section:
    """A group of settings."""

    title: str
    settings: tuple[Setting, ...]


def sections(run: Run) -> list[Section]:
    """Return all settings in a run's files, by section."""
    found = []
    if run.config:
        plain = {name: value for name, value in run.config.items()
                 if name not in ('training', 'world_settings')}
        found.append(Section('Run', _settings(plain, {}, ())))
    if run.training:
        preset, values = nearest_preset(run.world, run.training)
        title = f'Training (preset {preset})' if preset else 'Training'
        found.append(Section(
            title, _settings(run.training, values, training_config.describe())))
    if run.world_settings:
        infos: tuple[SettingInfo, ...] = ()
        values = dict(run.world_settings)
        if run.world in registry.names():
            infos = registry.settings(run.world)
            values |= registry.settings_from(run.world, values)
        found.append(Section('World', _settings(
            values, {info.name: info.default for info in infos}, infos)))
    return found


def nearest_preset(world: str, training: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return the preset with the fewest differences, and its values; '' if there is none."""
    best: tuple[int, str, dict[str, Any]] = (len(training) + 1, '', {})
    for name in presets.preset_names(world):
        values = presets.load_preset(name, world).flat()
        off = sum(
            _text(value) != _text(values.get(key)) for key, value in training.items()
            if key not in _UNREMARKABLE)
        if off < best[0]:
            best = off, name, values
    return best[1], best[2]


def _settings(
    values: Mapping[str, Any], usual: Mapping[str, Any], infos: tuple[SettingInfo, ...],
) -> tuple[Setting, ...]:
    """Return lines; settings missing in `usual` do not differ."""
    known = {info.name: info for info in infos}
    lines = []
    for name, value in values.items():
        other = _text(usual[name]) if name in usual else ''
        text, info = _text(value), known.get(name)
        lines.append(Setting(
            name, text, other if other != text else '',
            '' if info is None else info.description + (f', {info.unit}' if info.unit else '')))
    return tuple(lines)


def _text(value: object) -> str:
    """Return a value as written on the command line, for any numeric type."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return f'{value:.10g}'
    if isinstance(value, list | tuple):
        return f'[{", ".join(map(_text, value))}]'
    return '(empty)' if value == '' else str(value)
