# SPDX-License-Identifier: Apache-2.0
"""What a pilot is, and how it flies whole episodes."""
