# SPDX-License-Identifier: Apache-2.0
"""What runs a node: start, stop, waiting, parameters, diagnostics."""
