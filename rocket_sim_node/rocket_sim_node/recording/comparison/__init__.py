# SPDX-License-Identifier: Apache-2.0
"""Several pilots from equal starts in one recording."""
