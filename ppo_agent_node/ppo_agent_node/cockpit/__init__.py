# SPDX-License-Identifier: Apache-2.0
"""Cockpit for hand flying: keys, instruments, display, debriefing."""
