# SPDX-License-Identifier: Apache-2.0
"""A viewer of the standard views: subscribes to every topic of `ros_bridge`, as RViz would.

It takes messages from DDS without decoding them, so it needs less processor time than a Python
program that does.
"""
from __future__ import annotations

from contextlib import suppress

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import AccelStamped
from geometry_msgs.msg import PoseStamped
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

ROCKETS = 4
"""rockets that `ros_bridge` shows by default"""
STREAMS = {
    'odom': Odometry, 'pose': PoseStamped, 'imu': Imu, 'joint_states': JointState,
    'wrench': WrenchStamped, 'wind': AccelStamped}
"""topics of a rocket with one message per shown step"""


def main() -> None:
    """Receive messages until a signal."""
    rclpy.init()
    node = Node('views_subscriber')
    views = {**STREAMS, 'conditions': DiagnosticStatus, 'markers': MarkerArray}
    topics = {'/tf': TFMessage, 'markers': MarkerArray, **{
        f'rocket_{row}/{name}': kind for row in range(ROCKETS) for name, kind in views.items()}}
    for topic, kind in topics.items():
        node.create_subscription(kind, topic, lambda data: None, QoSProfile(depth=100), raw=True)
    print('subscribed to all views', flush=True)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == '__main__':
    main()
