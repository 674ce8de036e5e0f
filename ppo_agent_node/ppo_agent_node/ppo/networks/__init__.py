# SPDX-License-Identifier: Apache-2.0
"""Multilayer perceptrons, their input features, gradients and optimiser."""
