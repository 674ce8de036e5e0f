# SPDX-License-Identifier: Apache-2.0
"""How nodes reach a simulator and fly it."""
