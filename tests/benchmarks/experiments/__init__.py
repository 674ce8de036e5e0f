# SPDX-License-Identifier: Apache-2.0
"""Experiments on learning: policies trained in several ways, flown on the same fresh starts."""
