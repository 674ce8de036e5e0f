# SPDX-License-Identifier: Apache-2.0
"""Multilayer perceptrons, their inputs, their gradients and their optimiser."""
