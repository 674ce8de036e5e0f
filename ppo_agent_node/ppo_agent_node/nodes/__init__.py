# SPDX-License-Identifier: Apache-2.0
"""Nodes of this package: read parameters, run the core, one `main` each."""
