# SPDX-License-Identifier: Apache-2.0
"""Scripted pilot that identifies its vehicle in flight."""
