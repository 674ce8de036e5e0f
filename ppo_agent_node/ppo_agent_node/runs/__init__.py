# SPDX-License-Identifier: Apache-2.0
"""Files of a run: settings, log, checkpoints, metrics."""
