# SPDX-License-Identifier: Apache-2.0
"""A replacement for the ros2 command, for environments made of ROS 2 wheels, which lack it.

It knows what the commands, launch files and documents of this project use, with the output of the
real command, and refuses the rest by name. Where a full ROS 2 is sourced, its own ros2 is used and
this package is not.
"""
