# SPDX-License-Identifier: Apache-2.0
"""Changes that tests make to a machine: full or read-only disks, and a set system clock."""
