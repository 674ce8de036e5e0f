# SPDX-License-Identifier: Apache-2.0
"""Pilots: scripted, trained policy, random, and keyboard."""
