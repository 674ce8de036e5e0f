# SPDX-License-Identifier: Apache-2.0
"""Training runs: curriculum, roll-outs, policy selection, checkpoints."""
