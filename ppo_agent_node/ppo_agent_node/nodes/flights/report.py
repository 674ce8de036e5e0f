# SPDX-License-Identifier: Apache-2.0
"""The pictures and the page beside the figures of an evaluation."""
from __future__ import annotations

from pathlib import Path


def renew_report(folder: Path, plots: bool, section: str) -> None:
    """Draw a folder's pictures and write its page, or remove those that would be false.

    :param plots: whether they are wanted.
    :param section: the part of the page whose figures are new: Evaluation or Conditions.
    :raises ValueError: when a file of the folder is damaged; the message names it.
    :raises OSError: when something cannot be read, written or removed.
    """
    if not plots and not (folder / 'plots').is_dir():
        return
    # Imported here: plotting libraries are slow to import, and must not delay the start.
    from ppo_agent_node.commands import report

    if plots:
        report.write_report(folder)
    else:
        report.remove_report(folder, section)
