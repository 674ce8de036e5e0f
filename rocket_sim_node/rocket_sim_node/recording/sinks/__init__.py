# SPDX-License-Identifier: Apache-2.0
"""Destinations of a recording: a file, a live viewer, a web page."""
