# SPDX-License-Identifier: Apache-2.0
"""Rockets as standard messages of ROS show them, as plain values: motion, model, markers.

Node `ros_bridge` fills messages with them. World and body frames are those of REP 103: z up, and z
along the rocket's axis towards the nose.
"""
