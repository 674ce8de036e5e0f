# SPDX-License-Identifier: Apache-2.0
"""How a run looks to a person who waits: a display that stays in place, or plain lines."""
from ppo_agent_node.terminal.screen import Terminal

__all__ = ['Terminal']
