# SPDX-License-Identifier: Apache-2.0
"""The launch command: YAML launch files, their substitutions, and the processes they start."""
