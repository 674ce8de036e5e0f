# SPDX-License-Identifier: Apache-2.0
"""Demonstrations, behavioural cloning and DAgger."""
