# SPDX-License-Identifier: Apache-2.0
"""A training run: curriculum, roll-outs, selection of the best policy, checkpoints."""
