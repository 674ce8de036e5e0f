# SPDX-License-Identifier: Apache-2.0
"""The pictures and the page beside the figures of an evaluation.

Plotting libraries are slow to import, and must not delay the start.
"""
from __future__ import annotations

from pathlib import Path


def remove_report(folder: Path, sections: tuple[str, ...]) -> None:
    """Remove a folder's page, and the pictures of which new figures will be written.

    :param sections: of the page, with new figures: Evaluation, Conditions or Training.
    :raises OSError: when something cannot be removed.
    """
    if (folder / 'plots').is_dir() or (folder / 'report.html').exists():
        from ppo_agent_node.commands import report

        report.remove_report(folder, sections)


def write_report(folder: Path) -> None:
    """Draw a folder's pictures and write its page.

    :raises ValueError: when a file of the folder is damaged; the message names it.
    :raises OSError: when something cannot be read or written.
    """
    from ppo_agent_node.commands import report

    report.write_report(folder)
