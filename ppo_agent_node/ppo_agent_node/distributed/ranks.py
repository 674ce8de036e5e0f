# SPDX-License-Identifier: Apache-2.0
"""Ranks of a run, the processes that train it together, and what they exchange.

Each collective is called by all ranks in the same order, and gives all of them the same result,
bit for bit. Alone, a run has one rank, and its collectives do nothing.

Ranks that wait for one that fails learn why: on channel `main`, each operation begins with a
`gather`, in which a failed rank passes its error instead of a value.
"""
from __future__ import annotations

import ctypes
import functools
import math
import pickle
import re
from collections.abc import Callable
from collections.abc import Iterable
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from dataclasses import field
from datetime import timedelta
from typing import Any
from typing import TypeVar

import torch
from torch import Tensor
from torch import distributed

from ppo_agent_node.distributed.errors import RankLost

T = TypeVar('T')
Poll = Callable[[], None]
_POLL_INTERVAL = timedelta(milliseconds=50)
_LONGEST_TEXT = 500
"""characters of an error"""


def _no_poll() -> None:
    pass


def reason(error: Exception) -> str:
    """Return what an error of torch says, without its place in the source."""
    line = str(error).strip().partition('\n')[0]
    return re.sub(r'^\[[^]]*\] ', '', line).strip(' .')[:200]


@dataclass(frozen=True)
class _Failure:
    """Error of a rank, in place of the value that the others expect of it."""

    text: str


@dataclass
class Channel:
    """Collectives of all ranks, for the use of one thread."""

    index: int = 0
    """Of this rank."""
    count: int = 1
    """Of ranks."""
    group: Any = None
    """The process group of torch.distributed; None: a run of one rank."""
    broken: bool = False
    """Whether a collective failed or was abandoned; another would match none of the others."""

    def sum_(self, tensor: Tensor, poll: Poll = _no_poll) -> None:
        """Add up a tensor over all ranks, in place; on the CPU, wherever it is.

        :param poll: called while waiting; may raise.
        :raises RankLost: when another rank is gone.
        """
        if self.count == 1:
            return
        here = tensor.cpu()
        self._finish(functools.partial(distributed.all_reduce, here), poll)
        if here is not tensor:
            tensor.copy_(here)

    def mean(self, values: Sequence[float], poll: Poll = _no_poll) -> list[float]:
        """Return the means over all ranks; NaN where one has NaN."""
        if self.count == 1:
            return list(values)
        total = torch.tensor(values, dtype=torch.float64)
        self.sum_(total, poll)
        means: list[float] = (total / self.count).tolist()
        return means

    def copy_first_(self, tensors: Iterable[Tensor], poll: Poll = _no_poll) -> None:
        """Set tensors on the CPU to those of rank 0, in place."""
        if self.count == 1:
            return
        self.gather(None, poll)
        kinds: dict[torch.dtype, list[Tensor]] = {}
        for tensor in tensors:
            kinds.setdefault(tensor.dtype, []).append(tensor)
        for alike in kinds.values():
            flat = torch.cat([tensor.flatten() for tensor in alike])
            self._broadcast(flat, poll)
            for tensor, part in zip(
                    alike, flat.split([tensor.numel() for tensor in alike]), strict=True):
                tensor.copy_(part.view_as(tensor))

    def of_first(self, value: T, poll: Poll = _no_poll) -> T:
        """Return the value of rank 0; it is pickled."""
        if self.count == 1:
            return value
        data = _pickled(value) if self.index == 0 else torch.empty(0, dtype=torch.uint8)
        length = self.gather(len(data), poll)[0]
        if self.index:
            data = torch.empty(length, dtype=torch.uint8)
        self._broadcast(data, poll)
        return value if self.index == 0 else _unpickled(data)

    def gather(self, value: T, poll: Poll = _no_poll) -> list[T]:
        """Return the values of all ranks, by rank; they are pickled.

        :raises RankLost: when another rank is gone, or has failed; names its error.
        """
        if self.count == 1:
            return [value]
        found = self._gather(value, poll)
        for rank, each in enumerate(found):
            if isinstance(each, _Failure):
                raise RankLost(f'rank {rank} of {self.count} has failed: {each.text}')
        return found

    def fail(self, error: Exception, poll: Poll = _no_poll) -> None:
        """Tell the other ranks, in their next `gather`, that this one has failed."""
        if self.count == 1 or self.broken:
            return
        text = ' '.join(f'{type(error).__name__}: {error}'.split())
        with suppress(RankLost):
            self._gather(_Failure(text[:_LONGEST_TEXT]), poll)

    def _gather(self, value: Any, poll: Poll) -> list[Any]:
        mine = _pickled(value)
        lengths = [torch.zeros(1, dtype=torch.int64) for _ in range(self.count)]
        self._finish(functools.partial(
            distributed.all_gather, lengths, torch.tensor([len(mine)])), poll)
        padded = torch.zeros(max(map(int, lengths)), dtype=torch.uint8)
        padded[:len(mine)] = mine
        found = [torch.empty_like(padded) for _ in range(self.count)]
        self._finish(functools.partial(distributed.all_gather, found, padded), poll)
        return [_unpickled(data[:int(length)])
                for data, length in zip(found, lengths, strict=True)]

    def _broadcast(self, tensor: Tensor, poll: Poll) -> None:
        self._finish(functools.partial(distributed.broadcast, tensor, group_src=0), poll)

    def _finish(self, collective: Callable[..., Any], poll: Poll) -> None:
        """Run a collective, and poll until it is done."""
        try:
            work = collective(group=self.group, async_op=True)
        except RuntimeError as error:
            raise self._lost(error, poll) from error
        while not self._completed(work, poll):
            try:
                poll()
            except BaseException:
                self.broken = True
                # Freed with an unfinished collective, the group would wait for the other ranks.
                ctypes.pythonapi.Py_IncRef(ctypes.py_object(self.group))
                raise

    def _completed(self, work: Any, poll: Poll) -> bool:
        """Wait for a short time; return whether the collective is complete."""
        try:
            work.wait(_POLL_INTERVAL)
        except RuntimeError:  # time is over, or it has failed
            if not work.is_completed():
                return False
            try:
                work.wait()
            except RuntimeError as error:
                raise self._lost(error, poll) from error
        return True

    def _lost(self, error: Exception, poll: Poll) -> RankLost:
        """Return the error for one of torch, unless `poll` raises another: all may be stopping."""
        self.broken = True
        poll()
        return RankLost(
            f'rank {self.index} of {self.count} has lost another rank, which has ended or cannot '
            f'be reached ({reason(error)}); resume the run with all ranks')


def _pickled(value: object) -> Tensor:
    return torch.frombuffer(bytearray(pickle.dumps(value)), dtype=torch.uint8)


def _unpickled(data: Tensor) -> Any:
    # Ranks trust each other: torch.distributed has no authentication.
    return pickle.loads(data.numpy().tobytes())


@dataclass(frozen=True)
class Ranks:
    """This rank's channels to all ranks of its run."""

    index: int = 0
    count: int = 1
    main: Channel = field(default_factory=Channel)
    """For the thread that flies; each operation begins with `gather`."""
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
