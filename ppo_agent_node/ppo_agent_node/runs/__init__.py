# SPDX-License-Identifier: Apache-2.0
"""The files of a run: settings, log, checkpoints, metrics."""
