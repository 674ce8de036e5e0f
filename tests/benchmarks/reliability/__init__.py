# SPDX-License-Identifier: Apache-2.0
"""A long training among kills, and the time that a training takes to stop."""
