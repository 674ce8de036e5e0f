# SPDX-License-Identifier: Apache-2.0
"""What a test does to a machine: full or read-only disks, and a system clock that it sets."""
