# SPDX-License-Identifier: Apache-2.0
"""Standard messages of ROS from plain values."""
from __future__ import annotations

import functools
from collections.abc import Iterable
from collections.abc import Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.msg import KeyValue
from geometry_msgs.msg import AccelStamped
from geometry_msgs.msg import Point
from geometry_msgs.msg import PoseStamped
from geometry_msgs.msg import Quaternion
from geometry_msgs.msg import TransformStamped
from geometry_msgs.msg import Vector3
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker
from visualization_msgs.msg import MarkerArray

from rocket_sim_node.frames import WORLD
from rocket_sim_node.palette import Colour
from rocket_sim_node.standard_views import markers
from rocket_sim_node.standard_views.motion import RocketView
from rocket_sim_node.standard_views.vehicle_model import THROTTLE
from rocket_sim_node.standard_views.vehicle_model import VehicleModel
from rocket_sim_node.wire.messages.conversion import header

_NOT_KNOWN = -1.0
"""First element of a covariance matrix where the value is not known, as Imu.msg defines."""


def _vector(values: Iterable[float]) -> Vector3:
    x, y, z = values
    return Vector3(x=float(x), y=float(y), z=float(z))


def _point(values: Iterable[float]) -> Point:
    x, y, z = values
    return Point(x=float(x), y=float(y), z=float(z))


def _quaternion(values: Iterable[float]) -> Quaternion:
    x, y, z, w = values
    return Quaternion(x=float(x), y=float(y), z=float(z), w=float(w))


def pose(view: RocketView, stamp: int) -> PoseStamped:
    """Return the pose in the world frame."""
    message = PoseStamped(header=header(stamp, WORLD))
    message.pose.position = _point(view.position.tolist())
    message.pose.orientation = _quaternion(view.orientation.tolist())
    return message


def odometry(view: RocketView, stamp: int, body: str) -> Odometry:
    """Return pose in the world frame and twist in the child frame, `body`."""
    message = Odometry(header=header(stamp, WORLD), child_frame_id=body)
    message.pose.pose.position = _point(view.position.tolist())
    message.pose.pose.orientation = _quaternion(view.orientation.tolist())
    message.twist.twist.linear = _vector(view.linear.tolist())
    message.twist.twist.angular = _vector(view.angular.tolist())
    return message


def imu(view: RocketView, stamp: int, body: str) -> Imu:
    """Return what an ideal IMU at the origin of the body measures."""
    message = Imu(header=header(stamp, body))
    message.orientation = _quaternion(view.orientation.tolist())
    message.angular_velocity = _vector(view.angular.tolist())
    if view.specific_force is None:
        message.linear_acceleration_covariance[0] = _NOT_KNOWN
    else:
        message.linear_acceleration = _vector(view.specific_force.tolist())
    return message


def joint_states(view: RocketView, stamp: int, body: str, model: VehicleModel) -> JointState:
    """Return positions of the joints; the effort of the throttle is the thrust, N."""
    return JointState(
        header=header(stamp, body), name=[joint.name for joint in model.joints],
        position=model.positions(view),
        effort=[view.thrust if joint.name == THROTTLE else 0.0 for joint in model.joints])


def wrench(view: RocketView, stamp: int, body: str) -> WrenchStamped:
    """Return force and torque of engines and attitude control, in the body frame."""
    message = WrenchStamped(header=header(stamp, body))
    message.wrench.force = _vector((view.lateral_thrust, 0.0, view.thrust))
    message.wrench.torque = _vector(view.torque.tolist())
    return message


def wind(view: RocketView, stamp: int) -> AccelStamped:
    """Return the acceleration by wind and gusts, in the world frame."""
    message = AccelStamped(header=header(stamp, WORLD))
    message.accel.linear = _vector(view.disturbance.tolist())
    return message


def conditions(view: RocketView, name: str, names: Sequence[str]) -> DiagnosticStatus:
    """Return the values drawn for an episode."""
    return DiagnosticStatus(
        level=DiagnosticStatus.OK, name='conditions', hardware_id=name,
        message=f'episode {view.episode}', values=[
            KeyValue(key=key, value=repr(value))
            for key, value in zip(names, view.conditions.tolist(), strict=False)])


def transforms(
    view: RocketView, stamp: int, prefix: str, body: str, model: VehicleModel,
) -> list[TransformStamped]:
    """Return the transforms from the world to the body, and from there to moving links."""
    message = TransformStamped(header=header(stamp, WORLD), child_frame_id=body)
    message.transform.translation = _vector(view.position.tolist())
    message.transform.rotation = _quaternion(view.orientation.tolist())
    found = [message]
    for joint, position in zip(model.joints, model.positions(view), strict=True):
        translation, rotation = joint.transform(position)
        message = TransformStamped(
            header=header(stamp, body), child_frame_id=f'{prefix}/{joint.link}')
        message.transform.translation = _vector(translation)
        message.transform.rotation = _quaternion(rotation)
        found.append(message)
    return found


def marker_array(
    found: Iterable[markers.Marker], stamp: int, number: int = 0, body: str = WORLD,
) -> MarkerArray:
    """Return markers as a message.

    :param number: id of the markers in their namespaces.
    :param body: frame of those that are on the body.
    """
    return MarkerArray(markers=[_marker(one, stamp, number, body) for one in found])


@functools.lru_cache
def _colour(colour: Colour, opacity: float) -> Any:
    """Return a colour as a message; a flame has a hundred of them, most of them equal."""
    red, green, blue = colour
    return ColorRGBA(r=red / 255, g=green / 255, b=blue / 255, a=opacity)


def _marker(marker: markers.Marker, stamp: int, number: int, body: str) -> Marker:
    message = Marker(
        header=header(stamp, body if marker.on_body else WORLD), ns=marker.namespace, id=number,
        type=marker.shape.value, action=Marker.DELETE if marker.hidden else Marker.ADD,
        frame_locked=marker.on_body)
    message.pose.orientation.w = 1.0
    if marker.hidden:
        return message
    message.pose.position = _point(marker.position)
    message.scale = _vector(marker.size)
    message.text = marker.text
    colours = [_colour(colour, marker.opacity) for colour in marker.colours]
    if marker.points is not None:
        message.points = [_point(row) for row in marker.points.tolist()]
        if len(colours) == len(message.points):
            message.colors = colours
    message.color = colours[0]
    return message
