# SPDX-License-Identifier: Apache-2.0
"""What node `ppo_agent` does."""
