# SPDX-License-Identifier: Apache-2.0
"""Proximal policy optimisation (PPO): collect, compute advantages, update."""
