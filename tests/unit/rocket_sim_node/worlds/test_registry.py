# SPDX-License-Identifier: Apache-2.0
"""What the registry knows of a world, and of one that is not registered."""
from __future__ import annotations

from dataclasses import replace

import pytest

from rocket_sim_node import worlds
from rocket_sim_node.worlds import registry


def test_the_full_reach_of_a_world_that_is_not_registered() -> None:
    """That of a rocket, if it has the settings of one."""
    spec = replace(worlds.make('rocket', spawn_height=50.0).spec, name='mars')
    assert worlds.full_reach(spec) == pytest.approx(44.8)
    lander = replace(worlds.make('lunar_lander').spec, name='mars')
    with pytest.raises(ValueError, match=(
            r"^world 'mars': got no setting 'spawn_height', expected spawn_height and "
            r'touchdown_height, or a full_reach in the registry of worlds$')):
        worlds.full_reach(lander)


def test_settings_that_older_versions_do_not_have_are_those_of_the_world() -> None:
    for name in worlds.names():
        defaults = {info.name: info.default for info in worlds.settings(name)}
        added = registry.added_settings(name)
        assert added == {setting: defaults[setting] for setting in added}
    assert registry.added_settings('lunar_lander') == {'spawn_reach': 0.0}
    assert registry.added_settings('mars') == {}
