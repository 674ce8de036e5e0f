# SPDX-License-Identifier: Apache-2.0
"""Proximal policy optimisation: collect, compute advantages, update."""
