# SPDX-License-Identifier: Apache-2.0
"""Experiments on learning: policies trained in different ways fly the same fresh starts."""
