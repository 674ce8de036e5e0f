# SPDX-License-Identifier: Apache-2.0
"""World `rocket_planar`, and the contact model for touchdowns."""
