# SPDX-License-Identifier: Apache-2.0
"""Who gets which key: the controls theirs, and the rest are wishes about the flights."""
from __future__ import annotations

from ppo_agent_node.pilots.keyboard import KeyboardPilot
from ppo_agent_node.pilots.keys import HeldKeys
from ppo_agent_node.pilots.keys import KeyReader
from ppo_agent_node.pilots.keys import Motion

QUIT, NEXT, AGAIN, HELP = 'quit', 'next', 'again', 'help'
_COMMANDS = {
    'q': QUIT, 'ctrl+c': QUIT, 'ctrl+d': QUIT, 'r': NEXT, 'enter': NEXT, 't': AGAIN, 'h': HELP,
    '?': HELP,
}


class KeyboardCommands:
    """Reads what is typed: keys of the controls reach the pilot, others become commands.

    A key that is held asks once.
    """

    def __init__(self, pilot: KeyboardPilot) -> None:
        """Take whose controls they are."""
        self._pilot = pilot
        self._reader = KeyReader()
        self._held = HeldKeys(pilot.settings.repeat_delay, pilot.settings.repeat_gap)

    def take(self, data: bytes, now: float) -> list[str]:
        """Return the commands in what was typed.

        :param now: s, from a clock that never goes back.
        """
        commands = []
        events = self._reader.feed(data)
        if self._reader.exact:
            self._pilot.know_releases()
            self._held.know_releases()
        for event in events:
            if self._pilot.press(event, now):
                continue
            fresh = event.motion is Motion.PRESS and not self._held.held(event.key, now)
            self._held.move(event, now)
            if fresh and event.key in _COMMANDS:
                commands.append(_COMMANDS[event.key])
        return commands
