# SPDX-License-Identifier: Apache-2.0
"""What standard messages of ROS show of rockets, as plain values: motion, stamps, model, markers.

Node `ros_bridge` fills messages with them. World and body frames are those of REP 103: z up, and z
along the rocket's axis towards the nose.
"""
