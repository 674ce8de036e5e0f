# SPDX-License-Identifier: Apache-2.0
"""Speed of networks: an update by PPO, and an exported policy."""
