# SPDX-License-Identifier: Apache-2.0
"""Pilots: the scripted ones, the trained policy, and the keyboard."""
