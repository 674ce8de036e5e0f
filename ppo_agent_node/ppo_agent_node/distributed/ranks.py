# SPDX-License-Identifier: Apache-2.0
"""Ranks of a run, the processes that train it together, and what they exchange.

Each collective is called by all ranks in the same order, and gives all of them the same result,
bit for bit. Alone, a run has one rank, and its collectives do nothing.
"""
from __future__ import annotations

import functools
import math
import pickle
import time
from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import field
from typing import Any
from typing import TypeVar

import torch
from torch import Tensor
from torch import distributed

from ppo_agent_node.distributed.errors import RankLost

T = TypeVar('T')
Poll = Callable[[], None]
_BRIEFLY = 0.002
"""s for which a collective is watched without a pause: longer than one takes in a machine"""
_PAUSE = 0.0005
"""s between two looks at a collective that takes longer"""
_POLL_INTERVAL = 0.02
"""s"""


def _no_poll() -> None:
    pass


@dataclass(frozen=True)
class Channel:
    """Collectives of all ranks, for the use of one thread."""

    index: int = 0
    """Of this rank."""
    count: int = 1
    """Of ranks."""
    group: Any = None
    """The process group of torch.distributed; None: a run of one rank."""

    def sum_(self, tensor: Tensor, poll: Poll = _no_poll) -> None:
        """Add up a tensor over all ranks, in place.

        :param poll: called while waiting; may raise.
        :raises RankLost: when another rank is gone.
        """
        if self.count > 1:
            self._finish(lambda: distributed.all_reduce(
                tensor, group=self.group, async_op=True), poll)

    def mean(self, values: Sequence[float], poll: Poll = _no_poll) -> list[float]:
        """Return the means over all ranks; NaN where one has NaN."""
        if self.count == 1:
            return list(values)
        total = torch.tensor(values, dtype=torch.float64)
        self.sum_(total, poll)
        means: list[float] = (total / self.count).tolist()
        return means

    def copy_first_(self, tensors: Iterable[Tensor], poll: Poll = _no_poll) -> None:
        """Set tensors to those of rank 0, in place."""
        if self.count == 1:
            return
        for tensor in tensors:
            self._finish(functools.partial(
                distributed.broadcast, tensor, group_src=0, group=self.group, async_op=True), poll)

    def gather(self, value: T, poll: Poll = _no_poll) -> list[T]:
        """Return the values of all ranks, by rank; they are pickled."""
        if self.count == 1:
            return [value]
        mine = torch.frombuffer(bytearray(pickle.dumps(value)), dtype=torch.uint8)
        lengths = [torch.zeros(1, dtype=torch.int64) for _ in range(self.count)]
        self._finish(lambda: distributed.all_gather(
            lengths, torch.tensor([len(mine)]), group=self.group, async_op=True), poll)
        longest = max(int(length) for length in lengths)
        padded = torch.zeros(longest, dtype=torch.uint8)
        padded[:len(mine)] = mine
        found = [torch.empty_like(padded) for _ in range(self.count)]
        self._finish(lambda: distributed.all_gather(
            found, padded, group=self.group, async_op=True), poll)
        return [pickle.loads(data[:int(length)].numpy().tobytes())
                for data, length in zip(found, lengths, strict=True)]

    def _finish(self, begin: Callable[[], Any], poll: Poll) -> None:
        """Begin a collective and wait until it is done, without blocking."""
        began = polled = time.monotonic()
        try:
            work = begin()
            while not work.is_completed():
                now = time.monotonic()
                if now > began + _BRIEFLY:
                    time.sleep(_PAUSE)
                if now > polled + _POLL_INTERVAL:
                    polled = now
                    poll()
            work.wait()
        except distributed.DistError as error:
            raise self._lost(error) from error
        except RuntimeError as error:
            if type(error) is not RuntimeError:  # from poll
                raise
            raise self._lost(error) from error

    def _lost(self, error: Exception) -> RankLost:
        reason = str(error).strip().partition('\n')[0]
        return RankLost(
            f'rank {self.index} of {self.count} has lost another rank, which has ended or cannot '
            f'be reached ({reason:.200}); resume the run with all ranks')


@dataclass(frozen=True)
class Ranks:
    """This rank's channels to all ranks of its run."""

    index: int = 0
    count: int = 1
    main: Channel = field(default_factory=Channel)
    """For the thread that flies."""
    policy: Channel = field(default_factory=Channel)
    """For the thread that updates the policy."""
    critic: Channel = field(default_factory=Channel)
    """For the thread that updates the critic, at the same time."""

    @property
    def first(self) -> bool:
        """Whether this is the rank that writes the files of the run."""
        return self.index == 0

    def share(self, total: int) -> int:
        """Return how many of `total` samples each rank takes, rounded up."""
        return math.ceil(total / self.count)


ALONE = Ranks()
"""A run of one process."""
