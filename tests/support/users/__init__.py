# SPDX-License-Identifier: Apache-2.0
"""Tools of a user: a browser, a viewer, a terminal, a script of their own."""
