# SPDX-License-Identifier: Apache-2.0
"""Minimum-fuel and minimum-time landings from given starts."""
