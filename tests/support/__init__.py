# SPDX-License-Identifier: Apache-2.0
"""Helpers of several tests: processes, the commands of the documents, and folders by theme."""
