# SPDX-License-Identifier: Apache-2.0
"""Quality of service of a subscription that takes what all publishers of a topic offer."""
from __future__ import annotations

import argparse

from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy
from rclpy.qos import QoSHistoryPolicy
from rclpy.qos import QoSPresetProfiles
from rclpy.qos import QoSProfile
from rclpy.qos import QoSReliabilityPolicy


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        '--qos-profile', choices=QoSPresetProfiles.short_keys(), default='sensor_data',
        help='Quality of service preset profile to subscribe with (default: sensor_data)')
    parser.add_argument(
        '--qos-depth', metavar='N', type=int, help='Queue size setting to subscribe with')
    parser.add_argument(
        '--qos-history', choices=QoSHistoryPolicy.short_keys(),
        help='History of samples setting to subscribe with')
    parser.add_argument(
        '--qos-reliability', choices=QoSReliabilityPolicy.short_keys(),
        help='Quality of service reliability setting to subscribe with')
    parser.add_argument(
        '--qos-durability', choices=QoSDurabilityPolicy.short_keys(),
        help='Quality of service durability setting to subscribe with')


def choose(node: Node, args: argparse.Namespace, topic: str) -> QoSProfile:
    """Return what the options ask for; without any, what fits all publishers."""
    profile = QoSPresetProfiles.get_from_short_key(args.qos_profile)
    profile = QoSProfile(
        depth=profile.depth, history=profile.history, reliability=profile.reliability,
        durability=profile.durability)
    asked = (args.qos_depth, args.qos_history, args.qos_reliability, args.qos_durability)
    if any(value is not None for value in asked):
        if args.qos_depth is not None:
            profile.depth = args.qos_depth
        if args.qos_history is not None:
            profile.history = QoSHistoryPolicy.get_from_short_key(args.qos_history)
        if args.qos_reliability is not None:
            profile.reliability = QoSReliabilityPolicy.get_from_short_key(args.qos_reliability)
        if args.qos_durability is not None:
            profile.durability = QoSDurabilityPolicy.get_from_short_key(args.qos_durability)
        return profile
    offers = [info.qos_profile for info in node.get_publishers_info_by_topic(topic)]
    if not offers:
        return profile
    reliable = [offer.reliability == QoSReliabilityPolicy.RELIABLE for offer in offers]
    latched = [offer.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for offer in offers]
    profile.reliability = (
        QoSReliabilityPolicy.RELIABLE if all(reliable) else QoSReliabilityPolicy.BEST_EFFORT)
    profile.durability = (
        QoSDurabilityPolicy.TRANSIENT_LOCAL if all(latched) else QoSDurabilityPolicy.VOLATILE)
    for some, wanted, fallback in (
            (reliable, 'QoSReliabilityPolicy.RELIABLE', 'QoSReliabilityPolicy.BEST_EFFORT'),
            (latched, 'QoSDurabilityPolicy.TRANSIENT_LOCAL', 'QoSDurabilityPolicy.VOLATILE')):
        if any(some) and not all(some):
            print(f'Some, but not all, publishers are offering {wanted}. Falling back to '
                  f'{fallback} as it will connect to all publishers')
    return profile
