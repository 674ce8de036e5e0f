# SPDX-License-Identifier: Apache-2.0
"""Imitation learning: demonstrations, behavioural cloning and DAgger."""
