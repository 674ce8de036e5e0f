# SPDX-License-Identifier: Apache-2.0
"""Batched simulation of many planar vehicles in a few pymunk spaces."""
