# SPDX-License-Identifier: Apache-2.0
"""A run tries its starts on the simulators before it begins."""
from __future__ import annotations

from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Sequence
from typing import Any

import pytest

from ppo_agent_node.config.presets import load_preset
from ppo_agent_node.training import preflight
from rocket_sim_node.worlds.jobs import Job
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.rocket import conditions

ROBUST = load_preset('robust')
HARSH, MIX = (
    {**conditions.settings(name), 'level': level,
     'nominal_share': ROBUST.curriculum.curriculum_nominal_share}
    for name, level in (('harsh', 8), ('mix', 7)))


class Simulators:
    """Record resets, and refuse those that are in `refused`."""

    def __init__(self, *refused: dict[str, float]) -> None:
        """Start with nothing asked."""
        self.refused, self.asked = refused, []

    def fly(self, flights: Sequence[Callable[[], Job[Any]]]) -> Iterator[None]:
        for begin in flights:
            command = next(begin())
            assert isinstance(command, Reset)
            self.asked.append(command.settings)
            if command.settings in self.refused:
                raise ValueError('no such weather here')
            yield None


def test_all_starts_of_a_run_are_tried() -> None:
    """Those of `robust`: its level, the wider one under harsher conditions, demonstrations."""
    simulators = Simulators()
    preflight.try_starts(simulators.fly, ROBUST)
    demonstrations = simulators.asked[-1]
    assert simulators.asked[:-1] == [MIX, HARSH]
    assert demonstrations.items() > MIX.items()
    assert 'spawn_angle' in demonstrations


def test_a_refused_start_names_the_setting_that_requires_it() -> None:
    with pytest.raises(ValueError, match=r'^curriculum_wide_level: no such weather here$'):
        preflight.try_starts(Simulators(HARSH).fly, ROBUST)
    with pytest.raises(ValueError, match=r'^curriculum, level 7: no such weather here$'):
        preflight.try_starts(Simulators(MIX).fly, ROBUST)
    reverse = load_preset('from_scratch', curriculum_start_level=3)
    reached = {'level': 7, 'spawn_reach': reverse.curriculum.curriculum_start_reach}
    with pytest.raises(ValueError, match=r'^curriculum_start_reach: no such weather here$'):
        preflight.try_starts(Simulators(reached).fly, reverse)
