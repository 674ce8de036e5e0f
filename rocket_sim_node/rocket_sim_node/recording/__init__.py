# SPDX-License-Identifier: Apache-2.0
"""What a recording of flights and training holds, and how it looks. No ROS in here."""
