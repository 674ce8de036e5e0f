# SPDX-License-Identifier: Apache-2.0
"""Helpers for tests: processes, the commands of the documents, and folders by topic."""
