# SPDX-License-Identifier: Apache-2.0
"""Small trainings and their runs, a world to learn, and references to compare with."""
