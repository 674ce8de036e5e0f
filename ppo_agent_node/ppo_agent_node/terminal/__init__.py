# SPDX-License-Identifier: Apache-2.0
"""Progress of a run on the terminal: a display updated in place, or plain lines."""
from ppo_agent_node.terminal.screen import Terminal

__all__ = ['Terminal']
