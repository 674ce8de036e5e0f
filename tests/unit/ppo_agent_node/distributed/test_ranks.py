# SPDX-License-Identifier: Apache-2.0
"""Several processes that train one run: equal weights, averaged gradients, loss of a process."""
from __future__ import annotations

import socket
import time
from collections.abc import Callable
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
import torch
from support.training.rank_program import PATIENCE
from support.training.rank_program import free_port
from support.training.rank_program import train
from support.training.training_runs import GENTLE
from support.training.training_runs import left_by
from support.training.training_runs import log_without_times
from support.training.training_runs import weights

from ppo_agent_node.config.training_config import Config
from ppo_agent_node.config.training_config import make_config
from ppo_agent_node.distributed import rendezvous
from ppo_agent_node.distributed.errors import RankLost
from ppo_agent_node.distributed.ranks import ALONE
from ppo_agent_node.distributed.ranks import Channel
from ppo_agent_node.distributed.ranks import Ranks
from ppo_agent_node.distributed.rendezvous import joined
from ppo_agent_node.distributed.run_folder import open_folder
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.training.run_state import check_alike
from ppo_agent_node.training.run_state import description
from ppo_agent_node.training.trainer import Trainer
from rocket_sim_node import worlds
from rocket_sim_node.worlds import EnvironmentClosed
from rocket_sim_node.worlds.jobs import SerialFleet

SMALL: dict[str, Any] = {
    **GENTLE, 'iterations': 4, 'num_groups': 2, 'critic_warmup_iterations': 1,
    'checkpoint_interval': 1, 'selection_interval': 2, 'selection_episodes': 16}


@pytest.fixture(scope='module')
def straight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run of two ranks that nothing disturbed."""
    path = tmp_path_factory.mktemp('straight') / 'run'
    for text in train(path, 2, SMALL):
        assert text.endswith('finished\n'), text
    return path


@pytest.mark.slow
@pytest.mark.parametrize('killed', [0, 1])
def test_two_ranks_train_the_same_after_one_was_killed(
        straight: Path, tmp_path: Path, killed: int) -> None:
    path, other = tmp_path / 'run', 1 - killed
    said = train(path, 2, SMALL, on_rank={killed: {'die_at': 2}})[other]
    assert f'RankLost: rank {other} of 2 has lost another rank' in said, said
    for text in train(path, 2, SMALL, resume=True):
        assert text.endswith('finished\n'), text
    assert left_by(path) == left_by(straight)


@pytest.mark.parametrize('iteration', [2, 4])
@pytest.mark.parametrize('failed', [0, 1])
def test_an_error_of_a_rank_is_named_by_the_other(
        tmp_path: Path, failed: int, iteration: int) -> None:
    """After the last iteration, too, when rank 1 has nothing left to do."""
    path, other = tmp_path / 'run', 1 - failed
    values = {**SMALL, 'demonstration_episodes': 0, 'checkpoint_interval': 10,
              'selection_interval': 10}
    begun = time.monotonic()
    said = train(path, 2, values, on_rank={failed: {'full_at': iteration}})
    assert said[failed].rstrip().endswith("No space left on device: 'train.jsonl'"), said
    assert (f'RankLost: rank {failed} of 2 has failed: OSError: [Errno 28] No space left on '
            "device: 'train.jsonl'\n") in said[other], said
    assert time.monotonic() < begun + rendezvous._FAREWELL_PATIENCE / 2
    # Rank 0 saves what all have learnt when another rank fails.
    saved = RunFolder(path, resume=True).newest(pytest.fail)
    assert saved is not None
    assert saved[1].content['iteration'] == (iteration if failed else 0)


def test_a_failed_rank_waits_for_the_others_only_for_a_time(
        monkeypatch: pytest.MonkeyPatch) -> None:
    class Deaf(Channel):
        def fail(self, error: Exception, poll: Callable[[], None] = lambda: None) -> None:
            while True:
                poll()

    monkeypatch.setattr(rendezvous, '_FAREWELL_PATIENCE', 0.05)
    rendezvous._tell(Deaf(), ValueError('wrong'), lambda: None)


def test_all_ranks_report_a_folder_that_rank_0_cannot_use(straight: Path) -> None:
    first, second = train(straight, 2, SMALL)
    assert f'RunFolderError: {straight}: already holds a run' in first, first
    assert f'RunFolderError: rank 0: {straight}: already holds a run' in second, second


def test_a_rank_that_is_stopped_does_not_wait_for_one_that_sleeps(tmp_path: Path) -> None:
    begun = time.monotonic()
    first, = train(
        tmp_path / 'run', 2, SMALL, on_rank={0: {'stop_at': 2}, 1: {'sleep_at': 2}}, awaited=1)
    assert first.endswith('stopped\n'), first
    assert time.monotonic() < begun + PATIENCE / 2


@pytest.mark.slow
def test_a_checkpoint_of_two_ranks_is_resumed_by_one_and_back(tmp_path: Path) -> None:
    path = tmp_path / 'run'
    for text in train(path, 2, SMALL, stop_at=1):
        assert text.endswith('stopped\n') or 'RankLost' in text, text
    saved = RunFolder(path, resume=True).newest(pytest.fail)
    assert saved is not None
    begun = saved[1].content['iteration']
    assert begun < 4
    assert saved[1].content['ranks'] == 2
    one, = train(path, 1, SMALL, resume=True, stop_at=begun + 1)
    assert one.endswith('stopped\n'), one
    for text in train(path, 2, SMALL, resume=True):
        assert text.endswith('finished\n'), text
    stages = [(line['stage'], line['iteration']) for line in log_without_times(path)]
    assert stages[-5:] == [('finetune', number) for number in range(5)]


def test_flights_do_not_depend_on_the_number_of_ranks(straight: Path, tmp_path: Path) -> None:
    """Nor does the clone; only the update sums in another order."""
    path = tmp_path / 'run'
    one, = train(path, 1, SMALL)
    assert one.endswith('finished\n'), one
    flown = ('episodes', 'landing_rate', 'mean_return', 'mean_length', 'steps')
    theirs, ours = (
        [{name: line.get(name) for name in flown} for line in log_without_times(run)]
        for run in (straight, path))
    until = next(index for index, line in enumerate(ours) if line['episodes'] is not None) + 4
    assert theirs[:until] == ours[:until]


@pytest.mark.slow
def test_whole_episodes_of_different_lengths(tmp_path: Path) -> None:
    """With three ranks, and two threads each."""
    values = {**SMALL, 'start_copies': 4, 'iterations': 2, 'num_groups': 3, 'threads': 2,
              'desired_kl': 0.01}
    runs = [tmp_path / name for name in ('one', 'other')]
    for run in runs:
        for text in train(run, 3, values):
            assert text.endswith('finished\n'), text
    one, other = map(weights, runs)
    assert all(torch.equal(one[name], other[name]) for name in one)


@pytest.mark.slow
def test_averaged_gradients_are_those_of_all_samples(tmp_path: Path) -> None:
    """One minibatch of everything: two ranks take the step that one rank takes."""
    values = {
        **SMALL, 'demonstration_episodes': 0, 'iterations': 1, 'n_epochs': 1,
        'batch_size': 40 * 8 * 2, 'normalise_advantages': False, 'critic_warmup_iterations': 0,
        'log_std_final': 20.0}
    for count in (1, 2):
        for text in train(tmp_path / str(count), count, values):
            assert text.endswith('finished\n'), text
    one, two = (weights(tmp_path / str(count)) for count in (1, 2))
    assert one.keys() == two.keys()
    for name in one:
        if 'normaliser' not in name:
            torch.testing.assert_close(one[name], two[name], rtol=1e-4, atol=1e-7, msg=name)


def environment(**given: object) -> dict[str, str]:
    return {name: str(value) for name, value in {
        'RANK': 0, 'WORLD_SIZE': 2, 'MASTER_ADDR': '127.0.0.1', 'MASTER_PORT': free_port(),
        **given}.items()}


@pytest.mark.parametrize(('given', 'error'), [
    ({'WORLD_SIZE': 'two'}, "environment variable WORLD_SIZE: got 'two', expected 1 to 65536"),
    ({'RANK': 2}, "environment variable RANK: got '2', expected 0 to 1"),
    ({'RANK': ''}, "environment variable RANK: got '', expected 0 to 1"),
    ({'MASTER_PORT': 70000}, "environment variable MASTER_PORT: got '70000', expected 1 to 65535"),
    ({'MASTER_ADDR': ''}, 'environment variable MASTER_ADDR: not set'),
    ({'WORLD_SIZE': ''}, "environment variable WORLD_SIZE: not set, although RANK is '0'"),
])
def test_wrong_variables_are_named(given: dict[str, object], error: str) -> None:
    with pytest.raises(ValueError, match=error), joined(environment(**given)):
        pass


@pytest.mark.parametrize('given', [{}, {'WORLD_SIZE': '1', 'RANK': '0'}, {'WORLD_SIZE': '1'}])
def test_a_process_without_variables_is_alone(given: dict[str, str]) -> None:
    with joined(given) as ranks:
        assert ranks == ALONE


@pytest.mark.parametrize(('rank', 'count', 'missing'), [
    (0, 2, ', missing: 1'),
    (0, 100, f', missing: {" ".join(map(str, range(1, 21)))}'),
    (1, 2, ''),  # rank 0, which would know
])
def test_absent_ranks_are_reported(rank: int, count: int, missing: str) -> None:
    with (pytest.raises(TimeoutError, match=rf'rank {rank}: [01] of {count} ranks are at '
                        rf'127\.0\.0\.1:\d+{missing}, expected all$'),
          joined(environment(RANK=rank, WORLD_SIZE=count), patience=0.3)):
        pass


class Failing(Channel):
    """A channel whose user is asked to stop, or finds the others gone."""

    error: BaseException

    def gather(self, value: Any, poll: Callable[[], None] = lambda: None) -> list[Any]:
        raise self.error


@pytest.mark.parametrize('error', [EnvironmentClosed('asked to stop'), RankLost('rank 1')])
@pytest.mark.parametrize('begun', [False, True])
def test_a_folder_that_the_others_never_receive_is_left_as_it_was(
        tmp_path: Path, error: Exception, begun: bool) -> None:
    path, main = tmp_path / 'run', Failing(0, 2)
    main.error = error
    if begun:
        RunFolder(path).write_config({'version': '1'})
    before = sorted(path.rglob('*'))
    with pytest.raises(type(error)), open_folder(path, True, Ranks(0, 2, main)):
        pass
    assert path.exists() == begun
    assert set(before) <= set(path.rglob('*'))


@pytest.mark.parametrize(('given', 'error'), [
    ({'RANK': 0, 'WORLD_SIZE': 3},
     'WORLD_SIZE: got 3, another rank has 2, expected the same on all ranks'),
    ({'RANK': 1}, 'RANK: got 1, which another process has, expected a number of its own'),
])
def test_ranks_that_contradict_each_other_are_refused(
        given: dict[str, object], error: str) -> None:
    store = torch.distributed.TCPStore('127.0.0.1', 0, is_master=True, wait_for_workers=False)
    others = torch.distributed.PrefixStore('hoverslam/0/0', store)
    others.set('count', '2')
    others.add('rank/1', 1)
    rank = environment(**{'RANK': 1, 'MASTER_PORT': store.port, **given})
    with (mock.patch.object(rendezvous._Place, 'serves', False),
          pytest.raises(ValueError, match=f'environment variable {error}'), joined(rank)):
        pass


def test_an_occupied_port_is_reported() -> None:
    with socket.create_server(('127.0.0.1', 0)) as server:
        port = server.getsockname()[1]
        with (pytest.raises(OSError, match='rank 0 cannot listen here: Address already in use'),
              joined(environment(MASTER_PORT=port), patience=5.0)):
            pass


@pytest.fixture
def fleet() -> Iterator[SerialFleet]:
    yield SerialFleet(worlds.make('rocket', num_envs=8, level=7))


def config(**changes: Any) -> Config:
    return make_config({**SMALL, **changes})


def test_groups_that_ranks_cannot_share_are_refused(fleet: SerialFleet, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match='num_groups: got 3, expected a multiple of the number '
                       'of ranks, 2'):
        Trainer(fleet, config(num_groups=3), RunFolder(tmp_path / 'run'), ranks=Ranks(0, 2))


def test_ranks_with_other_settings_are_reported(fleet: SerialFleet) -> None:
    same, other, threads = (description(fleet.spec, config(**changes)) for changes in (
        {}, {'gamma': 0.5}, {'threads': 2}))
    check_alike([same, threads])
    with pytest.raises(ValueError, match=r'gamma: rank 1 has 0\.5, rank 0 has 0\.9999, expected '
                       'the same on all ranks'):
        check_alike([same, other])
