# SPDX-License-Identifier: Apache-2.0
"""Data that must be refused or ignored: forged files, forged messages, random bytes."""
