# SPDX-License-Identifier: Apache-2.0
"""Dispatch of keys: controls to the pilot, other keys to commands."""
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
    """Decodes typed keys: controls are passed to the pilot, others become commands.

    A key that is held gives one command.
    """

    def __init__(self, pilot: KeyboardPilot) -> None:
        """Store the pilot that receives the controls."""
        self._pilot = pilot
        self._reader = KeyReader()
        self._held = HeldKeys(pilot.settings.repeat_delay, pilot.settings.repeat_gap)

    def take(self, data: bytes, now: float) -> list[str]:
        """Return the commands in terminal input.

        :param now: s, from a monotonic clock.
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
