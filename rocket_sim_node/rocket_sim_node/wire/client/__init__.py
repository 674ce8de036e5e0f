# SPDX-License-Identifier: Apache-2.0
"""The agent's end of the wire: one simulator, or a fleet of them."""
