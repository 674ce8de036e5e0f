# SPDX-License-Identifier: Apache-2.0
"""Nodes and programs that exchange messages under the control of a test."""
