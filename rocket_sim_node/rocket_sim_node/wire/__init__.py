# SPDX-License-Identifier: Apache-2.0
"""Client and server for lock-step reinforcement learning over DDS."""
