# SPDX-License-Identifier: Apache-2.0
"""Worlds, client and server, recording, and their nodes."""

__version__ = '1.0.0'
"""The same as in package.xml and setup.py, here also where the package is not installed."""
