# SPDX-License-Identifier: Apache-2.0
"""Recordings that compare several pilots from equal starts."""
