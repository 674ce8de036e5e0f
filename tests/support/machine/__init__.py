# SPDX-License-Identifier: Apache-2.0
"""Changes to the machine for tests: full or read-only disks, and another system time."""
