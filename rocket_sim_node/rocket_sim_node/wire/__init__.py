# SPDX-License-Identifier: Apache-2.0
"""The wire: lock-step reinforcement learning over DDS, both ends of it."""
