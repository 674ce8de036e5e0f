# SPDX-License-Identifier: Apache-2.0
"""Trajectories: the samples of one episode, and which of them are recorded."""
