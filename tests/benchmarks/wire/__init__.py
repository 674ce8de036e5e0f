# SPDX-License-Identifier: Apache-2.0
"""Times of a lock-step exchange and of discovery, within a machine and between hosts."""
