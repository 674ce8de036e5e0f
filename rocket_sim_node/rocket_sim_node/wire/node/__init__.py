# SPDX-License-Identifier: Apache-2.0
"""Infrastructure of a node: start, stop, waiting, parameters, diagnostics."""
