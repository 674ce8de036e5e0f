# SPDX-License-Identifier: Apache-2.0
"""Many planar vehicles stepped in a few pymunk spaces."""
