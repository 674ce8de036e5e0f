# SPDX-License-Identifier: Apache-2.0
"""Modes of node `ppo_agent`: training and inference."""
