# SPDX-License-Identifier: Apache-2.0
"""Speed of a PPO update and of an exported policy."""
