# SPDX-License-Identifier: Apache-2.0
"""Writing of a run's checkpoints and policies."""
from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from ppo_agent_node.config.training_config import Config
from ppo_agent_node.ppo.policies.factory import Policy
from ppo_agent_node.ppo.policies.file import save_policy
from ppo_agent_node.runs.folder import RunFolder
from ppo_agent_node.runs.metrics_logger import MetricsLogger
from ppo_agent_node.runs.source_commit import source_commit
from ppo_agent_node.runs.tensor_file import Tensors
from ppo_agent_node.training import run_state
from ppo_agent_node.training.run_state import RunState
from ppo_agent_node.training.selection import Score
from rocket_sim_node.worlds import WorldSpec


class CheckpointWriter:
    """Writes the files of a run, and reports the latest ones."""

    def __init__(
        self, spec: WorldSpec, config: Config, folder: RunFolder, metrics: MetricsLogger,
        ranks: int,
    ) -> None:
        """Store the run's settings and folder.

        :param ranks: number of processes that train the run together.
        """
        self._spec, self._config, self._folder = spec, config, folder
        self._metrics, self._ranks = metrics, ranks

    def save_clone(self, policy: Policy, state: RunState) -> None:
        """Write the cloned policy.

        :raises OSError: naming the path.
        """
        self._save_policy(self._folder.cloned, policy, state, stage='clone')
        self._tell(self._folder.cloned, news=True)

    def save(
        self, tensors: Tensors, policy: Policy, state: RunState, best: Score | None = None,
    ) -> None:
        """Write a checkpoint, and the policy if it is the best so far.

        :param tensors: of the checkpoint.
        :param best: the policy's score, if it is the best.
        :raises OSError: naming the path.
        """
        content = run_state.content(state, self._spec, self._config, self._ranks)
        written = []
        if best:
            # Before the checkpoint, which refers to them: if the run ends in between, the
            # iteration is repeated and writes them again, identically if the computation is
            # reproducible.
            self._folder.save_best(tensors, content)
            self._save_policy(self._folder.policy, policy, state, **asdict(best))
            written.append(self._folder.policy)
        written.append(self._folder.save(state.iteration, tensors, content))
        self._tell(*written, news=best is not None)

    def _tell(self, *paths: Path, news: bool) -> None:
        """Report the latest files, and log a message unless it is an ordinary checkpoint."""
        names = ' and '.join(str(path.relative_to(self._folder.path)) for path in paths)
        self._metrics.keep(saved=names)
        self._metrics.message(f'saved {names}' if news else '')

    def _save_policy(self, path: Path, policy: Policy, state: RunState, **facts: Any) -> None:
        save_policy(
            path, policy, self._spec, self._config.network, self._config.run.seed,
            {'run': self._folder.name, 'commit': source_commit(), 'steps': state.steps,
             **run_state.drawn_conditions(self._spec, self._config), **facts})
