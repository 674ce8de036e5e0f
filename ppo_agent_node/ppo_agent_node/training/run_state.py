# SPDX-License-Identifier: Apache-2.0
"""State of a run at the start of an iteration, except for the weights, and its serialisation."""
from __future__ import annotations

import math
from collections.abc import Iterable
from collections.abc import Sequence
from dataclasses import asdict
from dataclasses import dataclass
from dataclasses import replace
from pathlib import Path
from typing import Any

from ppo_agent_node import __version__
from ppo_agent_node.config.training_config import Config
from ppo_agent_node.config.training_config import describe
from ppo_agent_node.runs.tensor_file import TensorFile
from ppo_agent_node.training.curriculum import Curriculum
from ppo_agent_node.training.reverse_curriculum import ReverseCurriculum
from ppo_agent_node.training.selection import Score
from rocket_sim_node import worlds
from rocket_sim_node.worlds import WorldSpec
from rocket_sim_node.worlds.registry import added_settings
from rocket_sim_node.worlds.rocket import conditions

_FREE_TO_CHANGE = frozenset({
    'threads', 'device', 'checkpoint_interval', 'evaluation_episodes', 'evaluation_seed', 'plots'})
"""Settings on which the weights depend by rounding at most, so that they may differ in a resumed
run."""

_NOTHING = object()
"""Placeholder for a setting that a description does not have."""


@dataclass(frozen=True)
class RunState:
    """Progress of a run. Random numbers need no state: see random_streams."""

    curriculum: Curriculum
    reverse: ReverseCurriculum
    iteration: int = 0
    """Completed iterations of fine-tuning."""
    steps: int = 0
    """Rocket steps taken."""
    episodes: int = 0
    """Episodes that ended in roll-outs."""
    lines: int = 0
    """Lines of the log written."""
    best: Score | None = None
    reset_iteration: int = 0
    """Iteration after which the world was last reset."""

    @property
    def best_return(self) -> float:
        """Highest mean return of an evaluation without noise so far."""
        return self.best.mean_return if self.best else -math.inf

    @property
    def landing_rate(self) -> float:
        """Landing rate in the window of the reverse curriculum, later of the levels.

        NaN while the window is not full: a few episodes say little.
        """
        now = self.curriculum if self.reverse.over else self.reverse
        full = len(now.recent) == now.config.curriculum_window
        return now.landing_rate if full else math.nan

    def advance(self, landed: Iterable[bool], hardest: Iterable[bool]) -> RunState:
        """Return the state with the curriculum after more episodes, in the order they ended.

        :param landed: whether each one landed.
        :param hardest: the same of those that began highest, for a reverse curriculum.
        """
        if self.reverse.over:
            return replace(self, curriculum=self.curriculum.advance(landed))
        return replace(self, reverse=self.reverse.advance(hardest))

    def news(self, before: RunState) -> str:
        """Return a text on how the task became harder since `before`, empty if it did not."""
        level, reverse = self.curriculum.level, self.reverse
        if level != before.curriculum.level:
            return f'level {before.curriculum.level} -> {level}'
        if reverse.reach == before.reverse.reach:
            return ''
        if reverse.over:
            return f'the whole task, level {level}' if level else 'the whole task'
        return f'reach {before.reverse.reach:.2f} -> {reverse.reach:.2f} m'


def description(spec: WorldSpec, config: Config) -> dict[str, Any]:
    """Return every setting of a run, for `config.yaml`."""
    return {
        'version': __version__, 'world': spec.name, 'num_envs': spec.num_envs, **_launched(spec),
        'training': config.flat(), 'world_settings': spec.settings,
    }


def drawn_conditions(spec: WorldSpec, config: Config) -> dict[str, str]:
    """Return the `conditions` that a run draws, nothing for a world without."""
    if not spec.condition_names:
        return {}
    return {'conditions': config.curriculum.conditions or conditions.name_of(spec.settings)}


def check_alike(descriptions: Sequence[dict[str, Any]]) -> None:
    """Check that all ranks of a run have the same settings.

    :raises ValueError: names one that differs, and the ranks.
    """
    first, *others = (
        {'version': one['version'], 'world': one['world'], 'num_envs': one['num_envs'],
         **one['training'], **one['world_settings']} for one in descriptions)
    for rank, other in enumerate(others, start=1):
        for name, expected in first.items():
            found = other.get(name, _NOTHING)
            if name not in _FREE_TO_CHANGE and found != expected:
                value = 'none' if found is _NOTHING else found
                raise ValueError(
                    f'{name}: rank {rank} has {value!s:.200}, rank 0 has {expected!s:.200}, '
                    'expected the same on all ranks')


def _launched(spec: WorldSpec) -> dict[str, str]:
    """Return the simulator's settings that `train` must set again when the run is resumed."""
    if not spec.condition_names:
        return {}
    return {
        'conditions': conditions.name_of(spec.settings),
        'observation': worlds.settings_from(spec.name, spec.settings)['observation']}


def content(state: RunState, spec: WorldSpec, config: Config, ranks: int = 1) -> dict[str, Any]:
    """Return a checkpoint's description of a run, serialisable as JSON.

    :param ranks: number of processes that train it together.
    """
    return {
        'iteration': state.iteration, 'steps': state.steps, 'episodes': state.episodes,
        'lines': state.lines,
        'level': state.curriculum.level, 'recent': [int(x) for x in state.curriculum.recent],
        'reach': state.reverse.reach, 'recent_hardest': [int(x) for x in state.reverse.recent],
        'reset_iteration': state.reset_iteration,
        'best': asdict(state.best) if state.best else None,
        'ranks': ranks,
        'description': description(spec, config),
    }


def change_of_ranks(checkpoint: TensorFile, ranks: int) -> str:
    """Return the end of a message if another number of ranks wrote a checkpoint, otherwise ''."""
    before = checkpoint.content.get('ranks', ranks)  # not in earlier checkpoints
    if before == ranks:
        return ''
    return f'; learners: {ranks} instead of {before!r:.20}, so the weights differ'


def from_content(path: Path, checkpoint: TensorFile, spec: WorldSpec, config: Config) -> RunState:
    """Return the state in a checkpoint.

    :raises ValueError: when it is of a run with other settings; names the file and the setting.
    """
    found = checkpoint.content
    _same(path, found.get('description'), description(spec, config))
    try:
        level = _count(found, 'level')
        if level > config.curriculum.curriculum_final_level:
            raise ValueError(
                f'level: got {level}, expected at most '
                f'{config.curriculum.curriculum_final_level}')
        return RunState(
            Curriculum(config.curriculum, level, tuple(map(bool, found['recent']))),
            _reverse(found, spec, config),
            _count(found, 'iteration'), _count(found, 'steps'), _count(found, 'episodes'),
            _count(found, 'lines'), _best(found),
            _count({'reset_iteration': 0, **found}, 'reset_iteration'))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ValueError(f'{path}: its content is not that of a run: {error!r}') from error


def _best(found: dict[str, Any]) -> Score | None:
    best = found['best']
    if best is None:
        return None
    score = Score(
        **{name: _count(best, name) for name in ('iteration', 'episodes', 'landed')},
        mean_return=best['mean_return'])
    if not isinstance(score.mean_return, float | int) or not math.isfinite(score.mean_return):
        raise ValueError(f'best: mean_return: got {score.mean_return!r:.200}, expected a number')
    if not score.landed <= score.episodes or not score.episodes:
        raise ValueError(f'best: got {score.landed} landings of {score.episodes} episodes')
    return score


def _reverse(found: dict[str, Any], spec: WorldSpec, config: Config) -> ReverseCurriculum:
    begun = ReverseCurriculum.begin(config.curriculum, spec)
    if 'reach' not in found:  # written before there was a reverse curriculum
        return begun
    reach = found['reach']
    if not isinstance(reach, float | int) or not 0 <= reach <= begun.full_reach:
        raise ValueError(f'reach: got {reach!r:.200}, expected 0 to {begun.full_reach:g} m')
    return replace(begun, reach=reach, recent=tuple(map(bool, found['recent_hardest'])))


def _count(found: dict[str, Any], name: str) -> int:
    value = found[name]
    if not isinstance(value, int) or not 0 <= value < 2**63:
        raise ValueError(f'{name}: got {value!r:.200}, expected a whole number from 0')
    return value


def _same(path: Path, found: Any, expected: dict[str, Any]) -> None:
    # A setting's default is the behaviour before the setting existed.
    before: dict[str, dict[str, Any]] = {
        'training': {info.name: info.default for info in describe()},
        'world_settings': added_settings(expected['world'])}
    try:
        pairs = [
            (name, found[name], expected[name]) for name in ('world', 'num_envs')
        ] + [
            (name, {**before[group], **found[group]}.get(name, _NOTHING), value)
            for group in ('training', 'world_settings')
            for name, value in expected[group].items() if name not in _FREE_TO_CHANGE
        ]
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f'{path}: has no description of its run: {error!r}') from error
    for name, theirs, ours in pairs:
        if theirs is _NOTHING:
            raise ValueError(
                f'{path}: the run has no {name}, expected {ours}; the run is older than this '
                'setting of its world; start another run')
        if _plain(theirs) != _plain(ours):
            raise ValueError(
                f'{path}: {name} of the run is {theirs!s:.200}, expected {ours}; '
                f'resume with the settings of its config.yaml, or start another run')


def _plain(value: Any) -> Any:
    """Return a value as JSON would return it."""
    return list(value) if isinstance(value, tuple) else value
