# SPDX-License-Identifier: Apache-2.0
"""A stand-in for the ros2 command, for environments made of ROS 2 wheels, which lack it.

It has the verbs that this project uses, with the options and the output of the real command.
Where a full ROS 2 is sourced, its own ros2 is used and this package is not.
"""
