# SPDX-License-Identifier: Apache-2.0
"""Simulated users: a browser, a viewer, a terminal, and a script of their own."""
