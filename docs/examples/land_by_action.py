# SPDX-License-Identifier: Apache-2.0
"""Lands a policy by action `land`: python docs/examples/land_by_action.py RECORDING."""
import sys

import rclpy
from rclpy.action import ActionClient
from rocket_msgs.action import Land

if len(sys.argv) != 2:
    sys.exit(f'usage: python {sys.argv[0]} RECORDING')
rclpy.init()
node = rclpy.create_node('operator')
client = ActionClient(node, Land, 'land')
client.wait_for_server()
sent = client.send_goal_async(
    Land.Goal(policy='rocket', episodes=8, output=sys.argv[1]),
    lambda message: print(message.feedback.text))
rclpy.spin_until_future_complete(node, sent)
answer = sent.result().get_result_async()
rclpy.spin_until_future_complete(node, answer)
result = answer.result().result
if result.code:
    sys.exit(f'error {result.code}: {result.message}')
print(f'landed {result.figures.landed} of {result.figures.episodes}; recording: {result.output}')
rclpy.shutdown()
