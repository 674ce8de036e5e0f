# SPDX-License-Identifier: Apache-2.0
"""World `rocket`: vehicle, dynamics, initial states and outcomes."""
