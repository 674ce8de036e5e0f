# SPDX-License-Identifier: Apache-2.0
"""An agent accepts valid answers of a simulator and reports invalid ones."""
from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rocket_msgs import msg
from rocket_msgs import srv
from support.invalid_data.fuzzing import ANY_F32
from support.invalid_data.fuzzing import ANY_FLOAT
from support.invalid_data.fuzzing import ANY_U64
from support.invalid_data.fuzzing import WIRE_TEXT
from support.invalid_data.fuzzing import damage

from rocket_sim_node import worlds
from rocket_sim_node.wire.client.answers import Answers
from rocket_sim_node.wire.client.connection import Connection
from rocket_sim_node.wire.client.connection import ConnectionOptions
from rocket_sim_node.wire.client.connection import WorldChanged
from rocket_sim_node.wire.client.latest_answers import LatestAnswers
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.wire.messages.cdr import Codec
from rocket_sim_node.worlds import EnvironmentRestarted
from rocket_sim_node.worlds.actions import checked_action
from rocket_sim_node.worlds.jobs import Reset
from rocket_sim_node.worlds.jobs import Restore
from rocket_sim_node.worlds.jobs import Snapshot

N, SESSION, STEP = 4, 77, 8
CODECS = {'observation': Codec(msg.Observation), 'reward': Codec(msg.Reward),
          'episodes': Codec(msg.Episodes)}
SPEC = worlds.make('rocket', num_envs=N).spec
ANY_VALUES = st.one_of(
    st.lists(st.integers(0, 300), max_size=6), st.lists(ANY_F32, max_size=6),
    st.lists(ANY_F32, min_size=N, max_size=N))


class FakeSubscription:
    """A subscription that a test fills with messages."""

    def __init__(self, topic: str) -> None:
        self.topic, self.posted = topic, deque[bytes]()

    def take(self) -> Any:
        """Return the oldest message as a subscription does."""
        return CODECS[self.topic].decode(self.posted.popleft()) if self.posted else None


@cache
def answer(ended: bool) -> dict[str, list[Any]]:
    """Return the arrays of a true step's messages, by topic; some episodes ended, or none."""
    world = worlds.make('rocket', num_envs=N, seed=2)
    while True:
        observation, reward, terminated, truncated, info = world.step(
            np.tile(np.float32([-1, 0, 0]), (N, 1)))
        if (0 < len(info['episodes']) < N) == ended:
            return {
                'observation': [observation],
                'reward': [reward, terminated, truncated, info['final_rows'],
                           info['final_observation']],
                'episodes': conversion.episode_arrays(info['episodes'])}


def check_answer(answers: Answers) -> None:
    """Take an answer and check that it is complete and valid."""
    step, (observation, reward, terminated, truncated, info) = answers.take()
    assert step == STEP + 1
    assert observation.shape == (N, SPEC.observation_size)
    assert reward.shape == terminated.shape == truncated.shape == (N,)
    assert terminated.dtype == truncated.dtype == np.bool_
    ended = np.flatnonzero(terminated | truncated)
    np.testing.assert_array_equal(info['final_rows'], ended)
    assert info['final_observation'].shape == (len(ended), SPEC.observation_size)
    episodes = info['episodes']
    for name in episodes.__dataclass_fields__:
        values = getattr(episodes, name)
        assert len(values) == len(ended)
        assert np.isfinite(values).all()
    assert set(terminated.view(np.uint8)) | set(truncated.view(np.uint8)) <= {0, 1}
    assert all(np.isfinite(v).all() for v in (observation, reward, info['final_observation']))
    assert (episodes.outcome < len(SPEC.outcomes)).all()


def awaiting() -> tuple[dict[str, FakeSubscription], Answers, list[str]]:
    """Return subscriptions, the object that awaits an answer in them, and its warnings."""
    subscriptions, said = {name: FakeSubscription(name) for name in CODECS}, list[str]()
    answers = Answers(list(subscriptions.values()), said.append)  # type: ignore[arg-type]
    answers.expect(SPEC)
    answers.await_step(SESSION, STEP)
    return subscriptions, answers, said


@given(st.booleans(), st.sampled_from(list(CODECS)), st.data())
def test_a_step_with_one_bad_field_is_refused_by_name(
        ended: bool, topic: str, data: st.DataObject) -> None:
    subscriptions, answers, _ = awaiting()
    for name, arrays in answer(ended).items():
        numbers, arrays = (SESSION, STEP + 1), list(arrays)
        if name == topic:
            if data.draw(st.integers(0, 5)) == 0:
                numbers = (data.draw(ANY_U64), data.draw(ANY_U64))
            place = data.draw(st.integers(0, len(arrays) - 1))
            with np.errstate(invalid='ignore'):
                arrays[place] = np.array(data.draw(ANY_VALUES)).astype(arrays[place].dtype)
        subscriptions[name].posted.append(CODECS[name].encode(numbers, arrays))
    if not answers.collect():
        return  # of another session or step
    try:
        check_answer(answers)
    except ValueError as error:
        assert str(error).startswith(('observation: ', 'reward: ', 'episodes: '))
        assert 'expected' in str(error)


@given(st.booleans(), st.sampled_from(list(CODECS)), st.data())
def test_damaged_answers_are_passed_over_or_refused(
        ended: bool, topic: str, data: st.DataObject) -> None:
    """A good answer that is sent again afterwards is accepted."""
    subscriptions, answers, said = awaiting()
    for name, arrays in answer(ended).items():
        good = CODECS[name].encode((SESSION, STEP + 1), arrays)
        if name == topic:
            subscriptions[name].posted.append(data.draw(damage(good)))
        subscriptions[name].posted.append(good)
    try:
        assert answers.collect()
        check_answer(answers)
    except ValueError as error:
        assert 'expected' in str(error)
    assert all('ignored: ' in text for text in said)


@given(st.data())
def test_any_description_is_a_world_or_refused_by_name(data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(['rocket', 'lunar_lander']))
    message = conversion.world_to_message(worlds.make(name, num_envs=N).spec, 1, 0, 0)
    texts = st.lists(WIRE_TEXT, max_size=5)
    wrong: dict[str, Any] = {
        'num_envs': st.integers(0, 2**32 - 1), 'dt': ANY_FLOAT, 'observation_names': texts,
        'action_names': texts, 'action_kind': st.integers(0, 255), 'mode': st.integers(0, 255),
        'action_low': st.lists(ANY_F32, max_size=4), 'action_high': st.lists(ANY_F32, max_size=4),
        'action_idle': st.lists(ANY_F32, max_size=4), 'action_count': st.integers(0, 2**32 - 1),
        'outcomes': texts, 'world': WIRE_TEXT,
        'settings': st.lists(st.builds(
            lambda k, v: msg.Setting(name=k, value=v), WIRE_TEXT, ANY_FLOAT), max_size=3)}
    for field in data.draw(st.lists(st.sampled_from(list(wrong)), min_size=1, max_size=2)):
        setattr(message, field, data.draw(wrong[field]))
    try:
        spec = conversion.world_from_message(message)
    except ValueError as error:
        assert str(error).startswith(('world: ', 'settings: '))
        return
    assert 1 <= spec.num_envs <= conversion.MOST_ENVS
    if spec.num_envs < 1000 and spec.continuous:
        idle = np.tile(np.array(spec.action_idle), (spec.num_envs, 1))
        np.testing.assert_array_equal(checked_action(spec, idle), idle)


@pytest.fixture
def connection(make_node: Callable[..., Any]) -> Connection:
    made = Connection(make_node()[0], ConnectionOptions(patience=0.0), 5)
    made.world = conversion.world_to_message(SPEC, SESSION, 0, msg.World.LOCKSTEP)
    made.adopt_spec()
    return made


@given(st.sampled_from(['reset', 'restore', 'snapshot']), st.integers(0, 255), WIRE_TEXT,
       st.one_of(st.just(SESSION), ANY_U64), st.one_of(st.just(0), ANY_U64),
       st.one_of(st.just(N * SPEC.observation_size), st.integers(0, 99)), st.data())
def test_any_answer_of_a_service_is_taken_or_refused(
        connection: Connection, name: str, code: int, text: str, session: int, step: int,
        size: int, data: st.DataObject) -> None:
    command = {'reset': Reset(1), 'restore': Restore(b''), 'snapshot': Snapshot()}[name]
    response = {'reset': srv.Reset, 'restore': srv.Restore,
                'snapshot': srv.Snapshot}[name].Response(
                    code=data.draw(st.sampled_from([0, code])), message=text)
    if name == 'snapshot':
        response.state = data.draw(st.binary(max_size=50))
    else:
        value = data.draw(ANY_F32)
        response.session, response.step = session, step
        response.observation = conversion.to_sequence(np.full(size, value), 'f4')
    connection.drop()
    connection._command, connection._asked = command, time.monotonic()
    try:
        done = connection._judge(command, response, time.monotonic())
    except (ValueError, EnvironmentRestarted, RuntimeError) as error:
        assert not isinstance(error, WorldChanged)
        assert name in str(error)
        return
    if not done:
        assert session != SESSION  # it waits for the description
        return
    taken = connection.take()
    if name == 'snapshot':
        assert taken == bytes(response.state)
    else:
        assert taken.shape == (N, SPEC.observation_size)
        assert np.isfinite(taken).all()


def test_the_observation_is_taken_before_the_results_arrive() -> None:
    subscriptions, answers, _ = awaiting()
    answers.await_step(SESSION, STEP, early=True)

    def post(topic: str) -> None:
        subscriptions[topic].posted.append(
            CODECS[topic].encode((SESSION, STEP + 1), answer(True)[topic]))

    assert not answers.observe()
    post('reward')  # whichever comes first
    assert not answers.observe()
    post('observation')
    assert answers.observe()
    assert not answers.collect()
    step, observation = answers.take_observation()
    assert step == STEP + 1
    np.testing.assert_array_equal(observation, answer(True)['observation'][0])
    post('episodes')
    assert answers.collect()
    results = answers.take_results()
    answers.await_step(SESSION, step)
    np.testing.assert_array_equal(results()[3]['final_rows'], answer(True)['reward'][3])
    assert not answers.observe()


def in_real_time(*posted: tuple[str, int, bool]) -> LatestAnswers:
    """Return the object that awaits an answer, after (topic, step, rockets ended) were sent."""
    subscriptions = {name: FakeSubscription(name) for name in CODECS}
    answers = LatestAnswers(list(subscriptions.values()), lambda text: None)  # type: ignore[arg-type]
    answers.expect(SPEC)
    answers.await_step(SESSION, STEP)
    for topic, step, ended in posted:
        subscriptions[topic].posted.append(
            CODECS[topic].encode((SESSION, step), answer(ended)[topic]))
    return answers


def test_in_real_time_lost_episodes_cost_a_step_and_no_error() -> None:
    """A later, complete step is accepted instead."""
    answers = in_real_time(
        ('observation', 9, True), ('reward', 9, True), ('episodes', 11, True),
        ('observation', 11, True), ('reward', 11, True))
    assert answers.collect()
    step, (_, _, terminated, truncated, info) = answers.take()
    assert step == 11
    np.testing.assert_array_equal(np.flatnonzero(terminated | truncated), info['final_rows'])
    assert len(info['episodes']) == len(info['final_rows'])


def test_a_real_time_answer_is_the_newest_step_with_all_rewards_and_ends() -> None:
    answers = in_real_time(*(
        (topic, step, step == 9) for step in range(STEP, 12) for topic in CODECS
        if topic != 'episodes' or step == 9), ('reward', 12, False))
    assert answers.collect()
    step, (observation, reward, terminated, truncated, info) = answers.take()
    assert step == 11
    np.testing.assert_array_equal(observation, answer(False)['observation'][0])
    after = range(STEP + 1, 12)
    np.testing.assert_allclose(
        reward, sum(answer(step == 9)['reward'][0] for step in after), rtol=1e-6)
    ended = answer(True)['reward']
    np.testing.assert_array_equal(terminated, ended[1])
    np.testing.assert_array_equal(truncated, ended[2])
    np.testing.assert_array_equal(info['final_rows'], ended[3])
    np.testing.assert_array_equal(info['final_observation'].ravel(), ended[4].ravel())
    assert len(info['episodes']) == len(ended[3])
    answers.await_step(SESSION, step)
    assert not answers.collect()
    assert answers.missing is not None
    assert answers.missing.topic == 'observation'  # the reward of step 12 is there


def test_a_later_step_in_real_time_is_not_that_of_the_observation_taken() -> None:
    answers = in_real_time(
        ('observation', STEP + 2, False), ('reward', STEP + 1, False),
        ('reward', STEP + 2, False))
    assert answers.observe()
    step, _ = answers.take_observation()
    assert step == STEP + 2
    for subscription in answers._subscriptions[:2]:
        topic = subscription.topic
        subscription.posted.append(  # type: ignore[attr-defined]
            CODECS[topic].encode((SESSION, STEP + 3), answer(False)[topic]))
    assert answers.collect()
    results = answers.take_results()
    answers.await_step(SESSION, step)
    np.testing.assert_allclose(results()[0], 2 * answer(False)['reward'][0], rtol=1e-6)
    assert answers.collect()
    assert answers.take()[0] == STEP + 3


@given(st.lists(st.tuples(
    st.sampled_from(list(CODECS)), st.one_of(st.integers(STEP - 2, STEP + 30), ANY_U64),
    st.booleans()), max_size=40))
def test_in_real_time_any_answer_is_a_complete_later_step(
        posted: list[tuple[str, int, bool]]) -> None:
    answers = in_real_time(*posted)
    if not answers.collect():
        assert answers.missing is not None
        return
    try:
        step, (observation, _, terminated, truncated, info) = answers.take()
    except ValueError as error:  # an end in one message, none in the other
        assert 'expected' in str(error)
        return
    assert step > STEP
    assert {('observation', step), ('reward', step)} <= {(topic, n) for topic, n, _ in posted}
    assert observation.shape == (N, SPEC.observation_size)
    np.testing.assert_array_equal(np.flatnonzero(terminated | truncated), info['final_rows'])
    assert all(len(kept) <= 16 for kept in answers._kept)
