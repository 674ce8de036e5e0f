# SPDX-License-Identifier: Apache-2.0
"""Steps/s of the worlds: by batch, by threads, under conditions, and of peers."""
