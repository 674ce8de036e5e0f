# SPDX-License-Identifier: Apache-2.0
"""Ranges of parameters: of the type that a message of ROS demands."""
from __future__ import annotations

import pytest

from rocket_sim_node import worlds
from rocket_sim_node.settings import SettingInfo
from rocket_sim_node.wire.node.parameters import _descriptor


@pytest.mark.parametrize('world', worlds.names())
def test_the_bounds_of_a_float_are_floats(world: str) -> None:
    """A whole number ends the node where ROS_PYTHON_CHECK_FIELDS is 1."""
    ranges = [one for info in worlds.settings(world)
              for one in _descriptor(info).floating_point_range]
    assert ranges
    assert {type(bound) for one in ranges for bound in (one.from_value, one.to_value)} == {float}


def test_an_empty_choice_is_visible() -> None:
    info = SettingInfo('conditions', '', '', 'set', 0.0, 1.0, choices=('', 'nominal', 'mix'))
    assert _descriptor(info).additional_constraints == "'', nominal, mix"
