# SPDX-License-Identifier: Apache-2.0
"""The default policy."""
from __future__ import annotations

import os
from pathlib import Path

import pytest

from ppo_agent_node.pilots.search import find_policy
from ppo_agent_node.pilots.search import shipped_names
from ppo_agent_node.runs import tensor_file


def run(runs: Path, name: str, world: str, time: int) -> Path:
    """Make what a run leaves."""
    folder = runs / name
    folder.mkdir(parents=True)
    (folder / 'config.yaml').write_text(f'world: {world}\n')
    policy = folder / 'policy.safetensors'
    tensor_file.write(policy, 'policy', {}, {})
    os.utime(policy, (time, time))
    return policy


def test_the_newest_policy_of_the_world_is_taken(tmp_path: Path) -> None:
    run(tmp_path, 'a', 'rocket', 100)
    newest = run(tmp_path, 'b', 'rocket', 300)
    run(tmp_path, 'c', 'rocket', 200)
    run(tmp_path, 'd', 'lunar_lander', 400)
    (tmp_path / 'd' / 'config.yaml').write_text('::: [')
    assert find_policy('', 'rocket', tmp_path) == newest


def test_damaged_and_unfinished_runs_are_skipped(tmp_path: Path) -> None:
    whole = run(tmp_path, 'a', 'rocket', 100)
    damaged = run(tmp_path, 'b', 'rocket', 200)
    damaged.write_bytes(damaged.read_bytes()[:-1])
    under_way = run(tmp_path, 'c', 'rocket', 300)
    (under_way.parent / '.unfinished').touch()
    assert find_policy('', 'rocket', tmp_path) == whole
    (under_way.parent / '.unfinished').unlink()
    assert find_policy('', 'rocket', tmp_path) == under_way


def test_the_shipped_policy_is_the_fallback(tmp_path: Path) -> None:
    shipped = find_policy('', 'rocket', tmp_path)
    assert shipped.name == 'rocket.safetensors'
    assert shipped.stat().st_size < 1 << 20


def test_a_named_file_has_to_exist(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match='policy: no file /nowhere'):
        find_policy('/nowhere', 'rocket', tmp_path)
    with pytest.raises(FileNotFoundError, match=r"'mars' below .*, and no policy ships"):
        find_policy('', 'mars', tmp_path)


def test_no_policy_of_another_world_is_taken(tmp_path: Path) -> None:
    run(tmp_path, 'a', 'rocket', 100)
    with pytest.raises(FileNotFoundError, match=(
            r"world 'rocket_planet' below .*, and no policy ships")):
        find_policy('', 'rocket_planet', tmp_path)


def test_policies_that_ship_have_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run(tmp_path, 'a', 'rocket', 100)
    shipped = find_policy('default', 'rocket', tmp_path)
    assert shipped == find_policy('rocket', 'rocket_planar', tmp_path)
    assert find_policy('default', 'lunar_lander', tmp_path).stem == 'lunar_lander'
    assert {'rocket', 'rocket_planar', 'lunar_lander'} <= set(shipped_names())
    with pytest.raises(FileNotFoundError, match=(
            r"policy: got 'robusst', expected a file or the name of a policy that ships: "
            r'default, .*lunar_lander.*rocket')):
        find_policy('robusst', 'rocket', tmp_path)
    # A file of that name here is what was meant.
    monkeypatch.chdir(tmp_path)
    Path('rocket').write_bytes(shipped.read_bytes())
    assert find_policy('rocket', 'rocket', tmp_path) == Path('rocket')
