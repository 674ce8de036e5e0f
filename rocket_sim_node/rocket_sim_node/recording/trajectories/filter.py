# SPDX-License-Identifier: Apache-2.0
"""Filter that selects the flights to record."""
from __future__ import annotations

from dataclasses import dataclass

from rocket_sim_node.settings import setting


@dataclass(frozen=True)
class RecordingFilter:
    """Selection of flights to record.

    While an agent learns, flights are similar for hours: every n-th is enough, and half of the
    capacity is reserved for the final evaluation. Otherwise every flight is recorded.
    """

    rows: tuple[int, ...] = setting(
        (0, 1, 2, 3), '', 'numbers of the rockets to record, of those that the simulator '
        'publishes', 0, 1e9)
    every_nth_episode: int = setting(
        5, 'episodes', 'interval, in episodes of a rocket, at which episodes are recorded while '
        'an agent learns', 1, 1e9)
    crashes: bool = setting(
        False, '', 'whether to record all crashes of those rockets, too, while an agent learns')
    max_steps: int = setting(
        200_000, 'steps', 'maximum number of steps recorded (about 100 KiB per 1000); while an '
        'agent learns, only half of it is used', 0, 1e12)

    def wanted(self, episode: int, *, landed: bool, learning: bool) -> bool:
        """Return whether a flight of a selected rocket is recorded."""
        return (
            not learning or episode % self.every_nth_episode == 0
            or (self.crashes and not landed))

    def room(self, *, learning: bool) -> int:
        """Return the total number of steps that may be recorded so far."""
        return self.max_steps // 2 if learning else self.max_steps
