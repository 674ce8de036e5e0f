# SPDX-License-Identifier: Apache-2.0
"""Tuning of a pilot's gains: search space, objective and optimiser loop.

Positive gains are searched on a log scale within the bounds of their settings. An optimiser has
the interface `ask` and `tell`, like CMA-ES in the package `cmaes`. All candidates fly the same
starts, so that only the gains differ.
"""
from __future__ import annotations

import math
from collections.abc import Callable
from collections.abc import Iterator
from collections.abc import Mapping
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ppo_agent_node.evaluation.runner import evaluate
from ppo_agent_node.flying.pilot import Pilot
from rocket_sim_node.settings import describe
from rocket_sim_node.worlds.base import F64
from rocket_sim_node.worlds.base import SimulatedWorld
from rocket_sim_node.worlds.base import WorldSpec

FIRST_SEED, LAST_SEED = 1_000, 999_999
"""Seeds for tuning; those of evaluations are higher."""

Gains = dict[str, float]
MakePilot = Callable[[WorldSpec, Mapping[str, float]], Pilot]
Return = Callable[[Gains], float]


class Optimiser(Protocol):
    """A minimiser such as CMA-ES (Hansen, 'The CMA evolution strategy: a tutorial', 2016)."""

    @property
    def population_size(self) -> int:
        """Candidates per generation."""
        ...

    @property
    def mean(self) -> F64:
        """Centre of the search, `(G,)`."""
        ...

    def ask(self) -> F64:
        """Return a candidate, `(G,)`."""
        ...

    def tell(self, solutions: list[tuple[F64, float]]) -> None:
        """Update with the costs of a generation of candidates."""
        ...


class GainSpace:
    """Some gains of a pilot as a vector of their logarithms, 0 at the initial values."""

    def __init__(
        self, settings_class: type, names: Sequence[str], start: Mapping[str, float],
    ) -> None:
        """Define the gains to search.

        :param start: initial values; those of other gains are constant.
        :raises ValueError: for a gain that is unknown, or not above 0 initially.
        """
        infos = {info.name: info for info in describe(settings_class)}
        unknown = sorted({*names, *start} - set(infos))
        if unknown:
            raise ValueError(
                f'gains: got {", ".join(map(repr, unknown))}, expected some of {", ".join(infos)}')
        self.names = tuple(names)
        self._fixed = {name: value for name, value in start.items() if name not in names}
        values = [float(start.get(name, _number(infos[name].default))) for name in names]
        for name, value in zip(names, values, strict=True):
            if not value > 0:
                raise ValueError(f'{name}: got {value:g}, expected more than 0 to be searched')
        self._start = np.log(values)
        self.bounds = np.array([
            (max(infos[name].low, 1e-9), min(infos[name].high, 1e9)) for name in names])

    @property
    def origin(self) -> F64:
        """The initial point, `(G,)`."""
        return np.zeros(len(self.names))

    def gains(self, point: F64) -> Gains:
        """Return the gains of a point `(G,)`, clipped to their bounds."""
        values = np.clip(np.exp(self._start + point), self.bounds[:, 0], self.bounds[:, 1])
        return {**self._fixed, **dict(zip(self.names, values.tolist(), strict=True))}

    def overshoot(self, point: F64) -> float:
        """Return the distance of a point from the bounds: squared, of logarithms."""
        outside = self._start + point - np.clip(
            self._start + point, *np.log(self.bounds).T)
        return float((outside**2).sum())


@dataclass(frozen=True)
class Task:
    """A world, level and starts on which gains are evaluated."""

    world: SimulatedWorld
    level: int
    seed: int
    weight: float = 1.0

    def __post_init__(self) -> None:
        """Check the seed.

        :raises ValueError: for a seed outside the range for tuning.
        """
        if not FIRST_SEED <= self.seed <= LAST_SEED:
            raise ValueError(
                f'seed: got {self.seed}, expected {FIRST_SEED} to {LAST_SEED}: the others are '
                'for evaluation')

    def mean_return(self, pilot: Pilot) -> float:
        """Return the mean return of one episode per rocket of the world."""
        count = self.world.spec.num_envs
        flown = evaluate(self.world, pilot, count, self.seed, level=self.level)
        return float(flown.episodes.episode_return.mean())


def judge(tasks: Sequence[Task], make_pilot: MakePilot) -> Return:
    """Return a function that evaluates gains: the weighted mean return."""
    total = sum(task.weight for task in tasks)

    def worth(gains: Gains) -> float:
        return sum(
            task.weight * task.mean_return(make_pilot(task.world.spec, gains))
            for task in tasks) / total

    return worth


@dataclass(frozen=True)
class Generation:
    """State of a search after a generation."""

    number: int
    flown: int
    """Candidates so far."""
    best_return: float
    best: Gains
    centre: Gains
    """The centre of the search, which is unbiased by the selection of starts."""
    median_return: float
    """Of this generation."""


def search(space: GainSpace, worth: Return, optimiser: Optimiser) -> Iterator[Generation]:
    """Improve gains forever, one generation at a time; the caller decides when to stop."""
    best_return, best = -math.inf, space.gains(space.origin)
    number = flown = 0
    while True:
        losses, returns = [], []
        for _ in range(optimiser.population_size):
            point = optimiser.ask()
            gains = space.gains(point)
            returns.append(worth(gains))
            losses.append((point, space.overshoot(point) - returns[-1]))
            if returns[-1] > best_return:
                best_return, best = returns[-1], gains
        optimiser.tell(losses)
        number, flown = number + 1, flown + len(losses)
        yield Generation(
            number, flown, best_return, best, space.gains(optimiser.mean),
            float(np.median(returns)))


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f'gains: got {value!r}, expected a number')
    return float(value)
