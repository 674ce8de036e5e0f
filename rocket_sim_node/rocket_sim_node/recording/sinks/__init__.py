# SPDX-License-Identifier: Apache-2.0
"""Where a recording goes: a file, a live viewer, a web page."""
