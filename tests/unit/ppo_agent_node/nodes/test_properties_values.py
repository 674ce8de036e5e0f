# SPDX-License-Identifier: Apache-2.0
"""Any action, setting or bytes are read correctly, or refused by name."""
from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from rocket_msgs import msg
from support.invalid_data.fuzzing import ANY_BYTES
from support.invalid_data.fuzzing import ANY_F32
from support.invalid_data.fuzzing import ANY_FLOAT
from support.invalid_data.fuzzing import ANY_U64
from support.invalid_data.fuzzing import damage

from ppo_agent_node.config import training_config
from ppo_agent_node.nodes import evaluate
from ppo_agent_node.nodes import keyboard_pilot
from ppo_agent_node.nodes import piloting
from ppo_agent_node.nodes.agent import inference
from ppo_agent_node.nodes.agent import modes
from ppo_agent_node.nodes.agent import training
from ppo_agent_node.nodes.flights import connection
from ppo_agent_node.pilots import keyboard
from rocket_sim_node import settings
from rocket_sim_node import worlds
from rocket_sim_node.nodes import rerun_recorder
from rocket_sim_node.nodes import simulation
from rocket_sim_node.recording.trajectories.filter import RecordingFilter
from rocket_sim_node.settings import SettingInfo
from rocket_sim_node.wire.messages.cdr import Codec
from rocket_sim_node.worlds.actions import Clipped
from rocket_sim_node.worlds.actions import checked_action
from rocket_sim_node.worlds.actions import commanded

SPEC = replace(
    worlds.make('rocket', num_envs=2).spec, action_low=(-1.0, -0.5, 0.0),
    action_high=(1.0, 0.25, 7.0))
DISCRETE = replace(SPEC, continuous=False, action_count=4)
LOW, HIGH = np.array(SPEC.action_low), np.array(SPEC.action_high)
INFOS = [
    *training_config.describe(),
    *(info for name in worlds.names() for info in worlds.settings(name)),
    *(info for cls in (
        simulation.SimulatorParameters, rerun_recorder.Destinations, RecordingFilter,
        modes.AgentParameters,
        training.TrainingParameters, inference.InferenceParameters,
        piloting.PilotParameters,
        keyboard_pilot.KeyboardParameters, keyboard.KeyboardSettings,
        evaluate.EvaluationParameters, connection.ConnectionParameters)
      for info in settings.describe(cls))]
ANY_ARRAY = hnp.arrays(
    st.one_of(hnp.scalar_dtypes(), st.just(np.dtype(object))),
    st.one_of(st.sampled_from([(2, 3), (2,)]), hnp.array_shapes(min_dims=0, max_side=4)))
ANY_VALUE = st.one_of(
    ANY_FLOAT, st.integers(), st.text(), st.binary(), st.booleans(), st.none(),
    st.sampled_from([10**400, -10**400, 2**63, 2**64]), st.lists(st.integers()),
    st.lists(st.one_of(ANY_FLOAT, st.text(), st.none())), st.dictionaries(st.text(), ANY_FLOAT))
KINDS = (msg.Action, msg.Observation, msg.Reward, msg.Episodes)


@pytest.mark.slow
@given(ANY_ARRAY)
def test_any_array_is_clipped_or_refused(action: np.ndarray[Any, Any]) -> None:
    for spec in (SPEC, DISCRETE):
        try:
            flown = checked_action(spec, action)
        except ValueError as error:
            assert str(error).startswith('action: ')
            assert 'expected' in str(error)
            with pytest.raises(ValueError, match='action: '):
                commanded(spec, action)
            continue
        assert np.isfinite(flown).all()
        if spec.continuous:
            assert flown.shape == (2, 3)
            assert ((flown >= LOW) & (flown <= HIGH)).all()
        else:
            assert ((flown >= 0) & (flown < 4)).all()


@given(hnp.arrays(np.float64, (2, 3), elements=st.floats(allow_nan=False, allow_infinity=False)))
def test_actions_sent_over_dds_fly_as_in_process(action: np.ndarray[Any, Any]) -> None:
    """A float64 is sent as the nearest float32; one that is out of bounds stays out of bounds."""
    sent = commanded(SPEC, action)
    assert sent.dtype == np.float32
    assert np.isfinite(sent).all()
    flown, here = checked_action(SPEC, sent), checked_action(SPEC, action)
    np.testing.assert_array_equal(flown.astype(np.float32), here.astype(np.float32))
    narrow = action.clip(-1e30, 1e30).astype(np.float32)
    assert commanded(SPEC, narrow) is narrow


@given(st.lists(hnp.arrays(
    np.float32, (2, 3), elements=st.floats(-9, 9, width=32)), max_size=5))
def test_clipped_values_are_counted_by_axis(actions: list[np.ndarray[Any, Any]]) -> None:
    clipped, expected = Clipped(SPEC), np.zeros(3, int)
    for action in actions:
        beyond = (action < LOW) | (action > HIGH)
        assert clipped.note(action, checked_action(SPEC, action)) == beyond.any()
        expected += beyond.sum(axis=0)
    assert list(clipped.counts.values()) == expected.tolist()
    assert bool(clipped.last) == bool(expected.any())


@given(st.sampled_from(INFOS), ANY_VALUE)
def test_a_setting_is_in_range_or_refused_by_name(info: SettingInfo, value: object) -> None:
    try:
        taken = settings.check(info, value)
    except (ValueError, TypeError) as error:
        assert info.name in str(error)
        assert 'expected' in str(error)
        return
    assert isinstance(taken, type(info.default))
    for number in taken if isinstance(taken, tuple) else (taken,):
        if isinstance(number, str):
            assert not info.choices or number in info.choices
        else:
            assert math.isfinite(number)
            assert isinstance(number, bool) or info.low <= number <= info.high


@given(st.sampled_from(KINDS), ANY_BYTES)
def test_any_bytes_are_a_message_or_refused(kind: Any, data: bytes) -> None:
    for header in (b'', b'\0\1\0\0', b'\0\0\0\0', b'\0\7\0\0'):
        try:
            message = Codec(kind).decode(header + data)
        except ValueError as error:
            assert 'cut short' in str(error) or 'not a message' in str(error)
            continue
        held = sum(getattr(value, 'nbytes', 8) for value in message)
        assert held <= len(header + data)


@given(st.sampled_from(KINDS), st.data())
def test_damaged_messages_hold_no_more_than_their_bytes(kind: Any, data: st.DataObject) -> None:
    codec = Codec(kind)
    fields = list(kind.get_fields_and_field_types().values())
    numbers = data.draw(st.lists(
        ANY_U64, min_size=(n := fields.count('uint64')), max_size=n))
    arrays = [np.array(data.draw(st.lists(st.integers(0, 9), max_size=4)))
              for _ in range(len(fields) - n)]
    bad = data.draw(damage(codec.encode(numbers, arrays)))
    try:
        message = codec.decode(bad)
    except ValueError as error:
        assert 'cut short' in str(error) or 'not a message' in str(error)
        return
    assert sum(value.nbytes for value in message[n:]) <= len(bad)


@given(st.lists(ANY_F32, min_size=1, max_size=8), ANY_U64)
def test_both_byte_orders_decode_to_the_same_message(values: list[float], number: int) -> None:
    data = np.array(values, '<f4')
    head = [b'\0\0\0\0', number.to_bytes(8, 'big'), number.to_bytes(8, 'big'),
            len(values).to_bytes(4, 'big'), data.astype('>f4').tobytes()]
    codec = Codec(msg.Observation)
    ours, theirs = codec.decode(codec.encode((number, number), (data,))), codec.decode(
        b''.join(head))
    assert ours[:2] == theirs[:2]
    assert ours.data.tobytes() == theirs.data.tobytes()
    assert theirs.data.dtype == np.float32
