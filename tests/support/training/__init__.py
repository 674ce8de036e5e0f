# SPDX-License-Identifier: Apache-2.0
"""Small trainings and their runs, a small world, and reference implementations."""
