# SPDX-License-Identifier: Apache-2.0
"""The landing with the least fuel and the one with the least time, start by start."""
