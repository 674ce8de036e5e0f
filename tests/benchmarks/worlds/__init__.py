# SPDX-License-Identifier: Apache-2.0
"""Steps/s of the worlds, by batch size, threads and conditions, and of peers."""
