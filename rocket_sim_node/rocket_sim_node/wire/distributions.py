# SPDX-License-Identifier: Apache-2.0
"""Differences between ROS 2 distributions, as far as they concern the wire.

Jazzy has rclpy 7 and Fast DDS 2, Kilted has rclpy 9 and Fast DDS 3. Everything here looks at what
is installed, not at a distribution's name, so that a later one works as far as it resembles them.
"""
from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos import qos_profile_services_default
from rclpy.type_support import check_is_valid_msg_type
from rclpy.type_support import check_is_valid_srv_type

_rclpy: Any = None
with suppress(ImportError):
    from rclpy.impl import implementation_singleton
    _rclpy = implementation_singleton.rclpy_implementation


@contextmanager
def initialised(**options: Any) -> Iterator[None]:
    """Initialise a context, and shut it down at the end.

    `rclpy.init` itself is such a context manager, but not in Jazzy.

    :param options: those of `rclpy.init`.
    """
    rclpy.init(**options)
    try:
        yield
    finally:
        rclpy.try_shutdown(context=options.get('context'))


@dataclass(frozen=True)
class FastDds:
    """How a version of Fast DDS is configured by XML profiles."""

    schema: str
    """XML schema of the profiles, below a prefix of ROS 2"""
    variables: tuple[str, ...]
    """environment variables that name a profile"""
    default: str
    """profile that is silently loaded from the working directory"""
    profiles: Path
    """folder of our own profiles"""


_PROFILES = Path(__file__).parent / 'dds' / 'profiles'
FAST_DDS_3 = FastDds(
    'share/fastdds/fastdds_profiles.xsd',
    ('FASTDDS_DEFAULT_PROFILES_FILE', 'FASTRTPS_DEFAULT_PROFILES_FILE'),
    'DEFAULT_FASTDDS_PROFILES.xml', _PROFILES / 'fast_dds_3')
FAST_DDS_2 = FastDds(
    'share/fastRTPS_profiles.xsd', ('FASTRTPS_DEFAULT_PROFILES_FILE',),
    'DEFAULT_FASTRTPS_PROFILES.xml', _PROFILES / 'fast_dds_2')


def fast_dds() -> tuple[FastDds, Path | None]:
    """Return the installed version of Fast DDS, and the schema of its profiles.

    Without a schema, as where Fast DDS is not installed, that is None and the version a guess.
    """
    for prefix in filter(None, os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)):
        for version in (FAST_DDS_3, FAST_DDS_2):
            schema = Path(prefix) / version.schema
            if schema.is_file():
                return version, schema
    return FAST_DDS_3, None


def subscribe(node: Node, kind: Any, topic: str, profile: QoSProfile) -> Any:
    """Return a subscription of rclpy's own C++ part, which no executor knows.

    That is no public interface. Where it has changed, return None: then subscribe by public means.
    """
    check_is_valid_msg_type(kind)  # also loads the type's C support
    try:
        _try_wait_set(node)
        with node.handle:
            return _rclpy.Subscription(node.handle, kind, topic, profile.get_c_qos_profile())
    except (AttributeError, TypeError):
        return None


def make_client(node: Node, kind: Any, name: str) -> Any:
    """Return a service's client of rclpy's own C++ part, or None, as :func:`subscribe` does."""
    check_is_valid_srv_type(kind)  # also loads the type's C support
    try:
        _try_wait_set(node)
        with node.handle:
            return _rclpy.Client(
                node.handle, kind, name, qos_profile_services_default.get_c_qos_profile())
    except (AttributeError, TypeError):
        return None


def _try_wait_set(node: Node) -> None:
    """Use a wait set and a guard condition once, to see whether this rclpy has both."""
    make_wait_set(node, 1, 0, 1, 0).add_guard_condition(make_guard_condition(node))


def make_wait_set(node: Node, subscriptions: int, timers: int, clients: int, services: int) -> Any:
    """Return a wait set of rclpy's own C++ part; only for subscriptions of :func:`subscribe`.

    It has room for one guard condition.
    """
    with node.context.handle:
        return _rclpy.WaitSet(
            subscriptions, 1, timers, clients, services, 0, node.context.handle)


def make_guard_condition(node: Node) -> Any:
    """Return a guard condition of rclpy's own C++ part, for such a wait set."""
    with node.context.handle:
        return _rclpy.GuardCondition(node.context.handle)
