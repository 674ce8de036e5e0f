# SPDX-License-Identifier: Apache-2.0
"""A plot for each experiment."""
