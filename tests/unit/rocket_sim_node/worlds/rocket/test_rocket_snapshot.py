# SPDX-License-Identifier: Apache-2.0
"""Snapshots restore the exact state, and anything else is refused."""
from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from support.invalid_data.forged_files import assert_refused
from support.invalid_data.forged_files import assert_value_refused
from support.invalid_data.forged_files import contents
from support.invalid_data.forged_files import packed

from rocket_sim_node import worlds
from rocket_sim_node.worlds.rocket.world import RocketWorld

N = 5


def flown(steps: int = 120, num_envs: int = N, **settings: Any) -> RocketWorld:
    """Return a world in the midst of flight."""
    world = worlds.make('rocket', num_envs, seed=9, **{'level': 8, **settings})
    for action in np.random.default_rng(1).uniform(-0.5, 0.5, (steps, num_envs, 3)):
        world.step(action)
    return world


@pytest.mark.parametrize('num_envs', [1, N])
def test_a_restored_world_flies_on_bit_for_bit(num_envs: int) -> None:
    """In a world of another seed and level; through ends of episodes and later spawns."""
    world = flown(num_envs=num_envs)
    world.reset(seed=21, level=7, spawn_height=90.0)
    for _ in range(40):
        world.step(np.full((num_envs, 3), 0.1))
    state, seen = world.snapshot(), world.observe()
    other = worlds.make('rocket', num_envs, seed=1, level=8)
    assert np.array_equal(other.restore(state), seen)
    assert other.snapshot() == state
    ended = 0
    for action in np.random.default_rng(2).uniform(-1, 0.4, (900, num_envs, 3)):
        mine, theirs = world.step(action), other.step(action)
        for a, b in zip(mine[:4], theirs[:4], strict=True):
            assert np.array_equal(a, b)
        assert np.array_equal(mine[4]['episodes'].episode_return,
                              theirs[4]['episodes'].episode_return)
        ended += len(mine[4]['final_rows'])
    assert ended > num_envs
    assert world.snapshot() == other.snapshot()
    assert np.array_equal(world.reset(), other.reset())


def test_a_snapshot_is_a_copy() -> None:
    """Later flights do not enter it, and restoring twice is the same."""
    world = flown()
    state = world.snapshot()
    first = [world.restore(state)] + [world.step(np.zeros((N, 3)))[0] for _ in range(50)]
    again = [world.restore(state)] + [world.step(np.zeros((N, 3)))[0] for _ in range(50)]
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))


def test_a_restore_replaces_the_results_of_the_last_step() -> None:
    """Telemetry and the rockets that finished belong to the flight that was left."""
    world = flown()
    state, reward = world.snapshot(), world.telemetry(np.arange(N)).reward
    world.position[1] = 5.0
    world.step(np.ones((N, 3)))
    assert len(world.finished.row) == N
    world.restore(state)
    assert not len(world.finished.row)
    assert world.telemetry(np.arange(N)).reward.tolist() == reward.tolist()


def test_a_truncated_snapshot_is_refused() -> None:
    """At every length."""
    world = flown()
    state = world.snapshot()
    for length in [*range(0, len(state), 53), len(state) - 1]:
        with pytest.raises(ValueError, match=f'snapshot: not readable, {length} bytes'):
            world.restore(state[:length])
    assert world.snapshot() == state


def test_an_array_hidden_by_damage_is_noticed() -> None:
    """Without it, the snapshot looks like an older one, which lacks this array."""
    world = flown()
    state = bytearray(world.snapshot())
    entry = b'PK\x01\x02'
    last = state.rindex(entry)
    before = state.rindex(entry, 0, last)
    # The entry before claims to have a comment, as long as the last entry.
    state[before + 32:before + 34] = (len(state) - 22 - last).to_bytes(2, 'little')
    assert_refused(world, bytes(state), 'snapshot: .*its directory is damaged')


@pytest.mark.slow
@pytest.mark.parametrize('bit', range(8))
def test_a_flipped_bit_is_refused_or_without_effect(bit: int) -> None:
    """A flip either shows or hits what carries no state (a date of the archive, say)."""
    world = flown()
    state = world.snapshot()
    wrong: dict[str, int] = {}
    # The archive's directory, at the end, byte by byte in threes; the rest more sparsely.
    for place in (*range(0, len(state), 13), *range(len(state) - 700, len(state), 3)):
        damaged = bytearray(state)
        damaged[place] ^= 1 << bit
        try:
            world.restore(bytes(damaged))
        except Exception as error:  # noqa: BLE001 - which ones come is what is asked
            if not isinstance(error, ValueError) or not str(error).startswith('snapshot: '):
                wrong[repr(error)] = place
        if world.snapshot() != state:
            pytest.fail(f'bit {bit} of byte {place} went unnoticed')
    assert not wrong


@pytest.mark.parametrize(('state', 'message'), [
    (b'', 'not readable, 0 bytes'),
    (b'no archive at all', 'not readable, 17 bytes'),
    (packed({'position': np.zeros(3)}), "of world '\\?', expected 'rocket'"),
    (packed({'world': 'lander'}), "of world 'lander', expected 'rocket'"),
    (packed({'world': 'rocket', 'position': np.zeros((3, N))}), r"holds \['position'\]"),
    (packed({'world': 'rocket', 'position': np.array([{}], object)}), 'not readable'),
    (packed({'world': np.array([{}], object)}), 'not readable'),
])
def test_data_that_is_not_a_snapshot_of_a_rocket_is_refused(state: bytes, message: str) -> None:
    """Pickles are not opened."""
    assert_refused(flown(3), state, f'snapshot: .*{message}')


def test_a_bare_array_is_refused() -> None:
    """A .npy file is not an archive."""
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(3))
    assert_refused(flown(3), buffer.getvalue(), 'snapshot: not readable')


def test_another_size_is_refused() -> None:
    """The message names an array with both shapes."""
    assert_refused(
        flown(3), flown(3, num_envs=N + 1).snapshot(),
        rf'position is float64 of shape \(3, {N + 1}\), .* shape \(3, {N}\)')


@pytest.mark.parametrize(('name', 'value', 'message'), [
    ('velocity', np.nan, 'velocity has a value that is not finite'),
    ('curriculum', 9, 'level: got 9'), ('curriculum', 7.5, 'level: got 7.5'), ('seed', -1, 'seed'),
])
def test_a_forged_value_is_refused_by_name(name: str, value: float, message: str) -> None:
    assert_value_refused(flown(10), name, value, message)


def test_a_forged_array_is_refused_by_name() -> None:
    world = flown(10)
    arrays = contents(world.snapshot())
    other = {**arrays, 'fuel': arrays['fuel'].astype(np.float32)}
    assert_refused(world, packed(other), 'fuel is float32')
    assert_refused(world, packed({**arrays, 'extra': np.zeros(1)}), 'extra')


def test_an_attitude_of_zeros_is_refused() -> None:
    """All zeros would fly on as NaN."""
    world = flown()
    arrays = contents(world.snapshot())
    arrays['attitude'] = arrays['attitude'] * 0.0
    assert_refused(world, packed(arrays), 'attitude')
