# SPDX-License-Identifier: Apache-2.0
"""Bags of ROS 2 in MCAP: written, repaired, and read back as arrays, without ROS."""
