# SPDX-License-Identifier: Apache-2.0
"""Pilot interface, and flights of whole episodes."""
