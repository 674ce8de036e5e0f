# SPDX-License-Identifier: Apache-2.0
"""What a user works with: a browser, a viewer, a terminal, a script of their own."""
