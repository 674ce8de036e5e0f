# SPDX-License-Identifier: Apache-2.0
"""Flights by nodes: connection to a simulator, evaluation, hand flying."""
