# SPDX-License-Identifier: Apache-2.0
"""Gaussian and categorical policies, and policy files."""
