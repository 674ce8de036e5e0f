# SPDX-License-Identifier: Apache-2.0
"""A simulator executes any request correctly, or refuses it and does not change."""
from __future__ import annotations

import tracemalloc
import zipfile
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import assume
from hypothesis import given
from hypothesis import strategies as st
from rocket_msgs import msg
from rocket_msgs import srv
from support.invalid_data.forged_files import contents
from support.invalid_data.forged_files import packed
from support.invalid_data.fuzzing import ANY_F32
from support.invalid_data.fuzzing import ANY_FLOAT
from support.invalid_data.fuzzing import ANY_I64
from support.invalid_data.fuzzing import ANY_U64
from support.invalid_data.fuzzing import WIRE_TEXT
from support.invalid_data.fuzzing import archive
from support.invalid_data.fuzzing import damage
from support.invalid_data.fuzzing import npy

from rocket_sim_node import worlds
from rocket_sim_node.wire.messages import conversion
from rocket_sim_node.wire.messages.cdr import Codec
from rocket_sim_node.wire.server.control import NOBODY
from rocket_sim_node.wire.server.server import Server
from rocket_sim_node.wire.server.server import ServerOptions

N, OWNER = 3, 0xABCDEF
CODEC = Codec(msg.Action)
_MOST = 30e6
"""bytes that any of this may take: a batch is some hundreds"""
_LOW = {'rocket_planar': {'spawn_height': 5.6, 'spawn_angle': 1.0, 'spawn_speed': 0.0}}
"""where flights come down softly, and soon, by world"""
_DISTURBED = {
    'conditions': 'harsh', 'observation': 'extended', 'wind_speed': (0.0, 10.0),
    'throttle_floor': (0.2, 0.6), 'ignitions': 3}
_STAGES, _APART = 8, 5
"""moments of such a flight, and steps from one to the next"""


class Bench:
    """A server whose handlers are called here, and what it is expected to do."""

    def __init__(self, make_node: Callable[..., Any], world: str, **settings: Any) -> None:
        self.node = make_node()[0]
        self.make = partial(worlds.make, world, N, seed=5, **settings)
        self.world, self.twin = self.make(), self.make()
        self.server = Server(self.node, self.world, ServerOptions())
        self.reset()

    @property
    def counts(self) -> Counter[str]:
        return Counter(self.server._health._counts)

    @property
    def place(self) -> tuple[Any, ...]:
        """Where the simulator is: its session, its step and the state of its world."""
        server = self.server
        return server._session, server._step, server._lease.owner, self.world.snapshot()

    def reset(self) -> None:
        response = self.server._on_reset(
            srv.Reset.Request(agent=OWNER, seed=1), srv.Reset.Response(), b'')
        assert response.code == response.OK
        self.twin.reset(1)
        self.fly(self.harmless())

    def harmless(self) -> np.ndarray[Any, Any]:
        """Return actions of the world's kind."""
        spec = self.world.spec
        return np.zeros((N, spec.action_size), np.float32) if spec.continuous else np.zeros(N, int)

    def stages(self) -> list[dict[str, Any]]:
        """Return what snapshots of a flight hold, from its start on, engine off."""
        world = self.make()
        world.reset(1, **_LOW.get(self.world.spec.name, {}))
        found = []
        for _ in range(_STAGES):
            found.append(contents(world.snapshot()))
            for _ in range(_APART):
                world.step(self.idle())
        return found

    def idle(self) -> np.ndarray[Any, Any]:
        """Return actions of the world's kind that burn nothing."""
        idle = np.array(self.world.spec.action_idle)
        return np.tile(idle, (N, 1)) if self.world.spec.continuous else np.full(N, int(idle[0]))

    def fly(self, action: np.ndarray[Any, Any]) -> None:
        """Have an action flown, here and by the twin."""
        self.act(self.server._session, self.server._step, OWNER, *self.arrays(action))
        self.twin.step(action)

    def arrays(self, action: np.ndarray[Any, Any]) -> tuple[np.ndarray[Any, Any], ...]:
        """Return an action as a message has it."""
        nothing = np.zeros(0)
        return (action, nothing) if self.world.spec.continuous else (nothing, action)

    def act(self, session: int, step: int, agent: int, *arrays: np.ndarray[Any, Any]) -> None:
        self.server._on_action(CODEC.decode(CODEC.encode((session, step, agent), arrays)))

    def refusal(self, where: str, before: Counter[str]) -> str:
        """Return why the last message was refused; it was counted once, and nothing else was."""
        assert self.counts - before == {f'refused on {where}': 1}
        text: str = self.server._health._refused
        assert text.startswith(f'{where}: ')
        assert len(text) < 400
        return text


@pytest.fixture(params=['rocket', 'rocket_planar', 'lunar_lander', 'rocket, disturbed'])
def bench(make_node: Callable[..., Any], request: pytest.FixtureRequest) -> Bench:
    world, _, disturbed = request.param.partition(', ')
    return Bench(make_node, world, **(_DISTURBED if disturbed else {}))


@given(data=st.data())
def test_any_action_is_flown_repeated_or_refused(bench: Bench, data: st.DataObject) -> None:
    """A model in this file predicts which."""
    bench.reset()
    server, spec = bench.server, bench.world.spec
    here, now = server._session, server._step
    session = data.draw(st.one_of(st.just(here), ANY_U64), 'session')
    step = data.draw(st.one_of(st.just(now), st.just(max(now - 1, 0)), ANY_U64), 'step')
    agent = data.draw(st.one_of(st.just(OWNER), ANY_U64), 'agent')
    size = data.draw(st.sampled_from([N * spec.action_size] * 3 + [0, 1, 50]), 'size')
    values = np.array(data.draw(st.one_of(
        st.lists(st.floats(-2, 2, width=32), min_size=size, max_size=size),
        st.lists(ANY_F32, min_size=size, max_size=size)), 'values'), np.float32)
    others = np.array(data.draw(st.one_of(
        st.just([]), st.lists(st.integers(0, 3), min_size=N, max_size=N),
        st.lists(st.integers(-2**31, 2**31 - 1), max_size=N))), np.int32)
    if not spec.continuous and data.draw(st.booleans()):
        values = values[:0]
    good = (not len(others) and len(values) == N * spec.action_size
            and bool(np.isfinite(values).all())) if spec.continuous else (
        not len(values) and len(others) == N and all(0 <= choice < 4 for choice in others))
    before, counts = bench.place, bench.counts
    bench.act(session, step, agent, values, others)
    addressed = (session, agent) == (here, OWNER)
    if addressed and step == now - 1:
        expected = {'repeated answers': 1}
        flown = bench.arrays(bench.harmless())
        if (values.tobytes(), others.tobytes()) != (
                flown[0].astype(np.float32).tobytes(), flown[1].astype(np.int32).tobytes()):
            expected['differing repeats'] = 1
        assert bench.counts - counts == expected
        assert bench.place == before
    elif addressed and step == now and good:
        assert bench.counts == counts
        bench.twin.step(values.reshape(N, -1) if spec.continuous else others)
        assert bench.place == (here, now + 1, OWNER, bench.twin.snapshot())
    else:
        assert 'expected' in bench.refusal('action', counts)
        assert bench.place == before


@given(ANY_U64, ANY_I64, st.lists(st.tuples(
    st.one_of(
        st.sampled_from(['level', 'spawn_speed', 'engine_lag_high', 'action_delay_high']),
        WIRE_TEXT),
    st.one_of(st.floats(0, 9), ANY_FLOAT)), max_size=4))
def test_any_reset_starts_a_new_session_or_is_refused(
        bench: Bench, agent: int, seed: int, settings: list[tuple[str, float]]) -> None:
    for asking in (agent, OWNER):
        before, counts = bench.place, bench.counts
        request = srv.Reset.Request(agent=asking, seed=seed, settings=[
            msg.Setting(name=name, value=value) for name, value in settings])
        response = bench.server._on_reset(request, srv.Reset.Response(), b'')
        if response.code == response.OK:
            assert bench.place[0] == response.session != before[0]
            assert np.isfinite(np.frombuffer(response.observation, np.float32)).all()
            observation = bench.world.step(bench.harmless())[0]
            assert np.isfinite(observation).all()
            bench.reset()
            continue
        assert response.code == (response.INVALID if asking == OWNER else response.BUSY)
        bench.refusal('reset', counts)
        assert bench.place == before
        assert len(response.message) < 400


@given(st.data())
def test_any_damaged_snapshot_is_the_same_state_or_refused(
        bench: Bench, data: st.DataObject) -> None:
    bench.reset()
    good = bench.world.snapshot()
    bad = data.draw(st.one_of(damage(good), st.binary(max_size=100)))
    assume(bad != good)
    before, counts = bench.place, bench.counts
    response = restore(bench, bad)
    if response.code == response.OK:
        assert bench.world.snapshot() == good  # what was damaged means nothing, a date perhaps
    else:
        assert response.code == response.INVALID
        assert 'snapshot: ' in bench.refusal('restore', counts)
        assert bench.place == before


@given(ANY_U64, ANY_U64, ANY_U64)
def test_snapshot_and_release_with_wrong_identifiers_are_refused(
        bench: Bench, agent: int, session: int, step: int) -> None:
    bench.reset()
    server = bench.server
    assume(agent != OWNER and session != server._session and step != server._step)
    for asking, its, at in (
            (agent, server._session, server._step), (OWNER, session, server._step),
            (OWNER, server._session, step)):
        before, counts = bench.place, bench.counts
        response = server._on_snapshot(
            srv.Snapshot.Request(agent=asking, session=its, step=at), srv.Snapshot.Response(), b'')
        assert response.code == (response.INVALID if asking == OWNER else response.BUSY)
        assert 'expected' in bench.refusal('snapshot', counts)
        assert bench.place == before
    counts = bench.counts
    response = server._on_release(srv.Release.Request(agent=agent), srv.Release.Response(), b'')
    assert response.code == response.BUSY
    bench.refusal('release', counts)
    assert bench.place == before


@given(st.one_of(st.sampled_from([NOBODY, OWNER]), ANY_U64))
def test_requests_that_need_control_are_refused_after_a_release(bench: Bench, agent: int) -> None:
    """Also those without an identity, and those of the agent that had control before."""
    bench.reset()
    server = bench.server
    response = server._on_release(srv.Release.Request(agent=OWNER), srv.Release.Response(), b'')
    assert response.code == response.OK
    session, step, owner, state = bench.place
    assert owner == NOBODY
    busy, invalid = srv.Reset.Response.BUSY, srv.Reset.Response.INVALID
    calls: dict[str, tuple[int | None, Callable[[], Any]]] = {
        'action': (None, lambda: bench.act(
            session, step, agent, *bench.arrays(bench.harmless()))),
        'snapshot': (busy, lambda: server._on_snapshot(
            srv.Snapshot.Request(agent=agent, session=session, step=step),
            srv.Snapshot.Response(), b'')),
        'release': (busy, lambda: server._on_release(
            srv.Release.Request(agent=agent), srv.Release.Response(), b'')),
        'reset': (invalid, lambda: server._on_reset(
            srv.Reset.Request(agent=NOBODY, seed=1), srv.Reset.Response(), b'')),
        'restore': (invalid, lambda: restore(bench, state, NOBODY))}
    for name, (code, call) in calls.items():
        counts = bench.counts
        assert getattr(call(), 'code', None) == code
        bench.refusal(name, counts)
        assert bench.place == (session, step, NOBODY, state)


def restore(bench: Bench, state: bytes, agent: int = OWNER) -> Any:
    """Return the answer to a restore; it took no memory worth mentioning."""
    request = srv.Restore.Request(agent=agent)
    request.state = conversion.to_sequence(np.frombuffer(state, np.uint8), 'u1')
    tracemalloc.start()
    try:
        response = bench.server._on_restore(request, srv.Restore.Response(), b'')
        assert tracemalloc.get_traced_memory()[1] < _MOST
    finally:
        tracemalloc.stop()
    return response


def forged(data: st.DataObject, array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return an array with another value, of any order of magnitude, in one place."""
    array = array.copy()
    place = data.draw(st.integers(0, array.size - 1))
    if array.dtype.kind == 'b':
        array.flat[place] ^= True
    elif array.dtype.kind == 'i':
        array.flat[place] = data.draw(st.one_of(st.integers(-2, 2**63 - 1), st.integers(-2, 300)))
    else:
        array.flat[place] = data.draw(st.sampled_from([-3.7, 3.7])) * 10.0**data.draw(
            st.integers(-6, 17))
    return array


def test_accepted_snapshots_lead_to_snapshots_that_are_accepted(bench: Bench) -> None:
    """A forged state is refused, or every state that follows from it can be restored."""
    stages = bench.stages()
    names = sorted(
        name for name in stages[0].keys() - {'world', 'settings'} if stages[0][name].size)
    if bench.world.spec.name == 'rocket_planar':
        assert 0 < sum(bool(stage['contact_present'].all()) for stage in stages) < _STAGES
    other = bench.make()
    accepted = 0

    @given(st.data())
    def fly_on(data: st.DataObject) -> None:
        nonlocal accepted
        bench.reset()
        arrays = dict(stages[data.draw(st.integers(0, _STAGES - 1), 'stage')])
        for name in data.draw(st.lists(st.sampled_from(names), min_size=1, max_size=3), 'names'):
            arrays[name] = forged(data, arrays[name])
        before, counts = bench.place, bench.counts
        response = restore(bench, packed(arrays))
        if response.code != response.OK:
            assert response.code == response.INVALID
            assert 'snapshot: ' in bench.refusal('restore', counts)
            assert bench.place == before
            return
        accepted += 1
        for _ in range(3):
            state = bench.world.snapshot()
            other.restore(state)
            assert other.snapshot() == state
            observation, reward, *_ = bench.world.step(bench.idle())
            assert np.isfinite(observation).all() and np.isfinite(reward).all()

    fly_on()
    assert accepted > 10


def array_file(shape: str, data: bytes = b'') -> bytes:
    """Return an archive of one array that says that it has a shape."""
    header = "{'descr': '<f8', 'fortran_order': False, 'shape': %s, }"
    return archive([('world.npy', npy(header % shape, data))])


FORGERIES: dict[str, Callable[[dict[str, Any], str], bytes]] = {
    'unpacks to 50 megabytes': lambda arrays, name: archive(
        [('world.npy', bytes(50_000_000))], zipfile.ZIP_DEFLATED),
    'promises an exabyte': lambda arrays, name: array_file(f'({2**57},)'),
    'overflows': lambda arrays, name: array_file(f'({2**63}, {2**63})'),
    'a negative shape': lambda arrays, name: array_file('(-1,)', bytes(80)),
    'a deep header': lambda arrays, name: archive([('world.npy', npy('(' * 9000))]),
    'a long header': lambda arrays, name: archive(
        [('world.npy', npy('{' + ' ' * 60000 + '}'))]),
    'code for a header': lambda arrays, name: archive(
        [('world.npy', npy("__import__('os').mkdir('boom')"))]),
    'objects': lambda arrays, name: packed({**arrays, name: np.array([{'a': 1}], object)}),
    'a bare array': lambda arrays, name: npy(
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1099511627776,), }"),
    'a name twice': lambda arrays, name: archive(
        [('world.npy', npy("{'descr': '<f8', 'fortran_order': False, 'shape': (), }", bytes(8))),
         ('world', b'')]),
    'not finite': lambda arrays, name: packed({**arrays, name: arrays[name] * np.nan}),
    'a forged count': lambda arrays, name: packed({**arrays, name: np.zeros(2**10)}),
}


@pytest.mark.parametrize('what', FORGERIES)
def test_forged_snapshots_are_refused_and_take_no_memory(bench: Bench, what: str) -> None:
    arrays = contents(bench.world.snapshot())
    name = next(name for name, array in arrays.items() if array.dtype.kind == 'f')
    before, counts = bench.place, bench.counts
    response = restore(bench, FORGERIES[what](arrays, name))
    assert response.code == response.INVALID
    assert 'snapshot: ' in bench.refusal('restore', counts)
    assert bench.place == before


def test_the_refusal_of_a_long_request_has_bounded_length(bench: Bench) -> None:
    settings = [msg.Setting(name=f'{k}' + 'x' * 100_000, value=0.0) for k in range(20)]
    counts = bench.counts
    response = bench.server._on_reset(
        srv.Reset.Request(agent=OWNER, settings=settings), srv.Reset.Response(), b'')
    assert response.code == response.INVALID
    assert len(response.message) < 400
    assert 'characters' in bench.refusal('reset', counts)


def test_commands_beyond_the_limits_are_clipped_as_in_process_and_counted(
        make_node: Callable[..., Any]) -> None:
    bench = Bench(make_node, 'rocket')
    values = np.full((N, 3), 0.5, np.float32)
    values[1, 0], values[2, 0], values[0, 1] = 1.5, -7.0, np.float32(3e38)
    before = bench.counts
    bench.fly(values)
    assert bench.world.snapshot() == bench.twin.snapshot()
    assert bench.counts == before
    present = bench.server._present()
    assert [present[f'clipped {axis}'] for axis in ('throttle', 'rcs_x', 'rcs_z')] == [2, 1, 0]
    assert present['last clipped'] == "row 2, 'throttle' is -7, expected -1 to 1"
    rng = np.random.default_rng(1)
    for scale in (1.0, 3.0, 1e30):
        bench.fly(rng.normal(0, scale, (N, 3)).astype(np.float32))
        assert bench.world.snapshot() == bench.twin.snapshot()
