# SPDX-License-Identifier: Apache-2.0
"""Publishers of the standard messages: those of one rocket, and those of a whole world."""
from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import AccelStamped
from geometry_msgs.msg import PoseStamped
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from rocket_sim_node.nodes.bridge import messages
from rocket_sim_node.nodes.bridge.topics import Topic
from rocket_sim_node.nodes.bridge.topics import Topics
from rocket_sim_node.recording.trajectories.world_info import WorldInfo
from rocket_sim_node.standard_views.markers import Ends
from rocket_sim_node.standard_views.markers import RocketMarkers
from rocket_sim_node.standard_views.markers import scene
from rocket_sim_node.standard_views.motion import Moment
from rocket_sim_node.standard_views.motion import RocketView
from rocket_sim_node.standard_views.vehicle_model import BASE_LINK
from rocket_sim_node.standard_views.vehicle_model import VehicleModel
from rocket_sim_node.standard_views.vehicle_model import vehicle_model
from rocket_sim_node.wire.dds import qos
from rocket_sim_node.wire.messages import conversion

MARKER_PERIOD = 40_000_000
"""ns of simulated time between two sets of markers, which are larger than the rest."""


class RocketPublishers:
    """Publishers of one rocket, below its name, such as `rocket_0`."""

    def __init__(self, topics: Topics, row: int, prefix: str) -> None:
        """Create them.

        :param prefix: of the names of frames.
        """
        self.name = f'rocket_{row}'
        self.frames = f'{prefix}{self.name}'
        self.body = f'{self.frames}/{BASE_LINK}'
        self._row = row
        self._topics: dict[str, Topic] = {}
        for kind, topic, profile in (
            (Odometry, f'{self.name}/odom', qos.VIEWS),
            (PoseStamped, f'{self.name}/pose', qos.VIEWS),
            (Imu, f'{self.name}/imu', qos.VIEWS),
            (JointState, f'{self.name}/joint_states', qos.VIEWS),
            (WrenchStamped, f'{self.name}/wrench', qos.VIEWS),
            (AccelStamped, f'{self.name}/wind', qos.VIEWS),
            (DiagnosticStatus, f'{self.name}/conditions', qos.LATCHED),
            (MarkerArray, f'{self.name}/markers', qos.VIEWS),
        ):
            self._topics[topic.rpartition('/')[2]] = topics.open(kind, topic, profile)
        self._drawn_at = -MARKER_PERIOD
        self._told: tuple[int, bytes] | None = None

    def begin(self, info: WorldInfo, model: VehicleModel) -> None:
        """Start publishing another world."""
        self._info, self._model = info, model
        self._markers = RocketMarkers(info)
        self._told = None

    def publish(self, view: RocketView, stamp: int) -> None:
        """Publish the messages of a state.

        :raises ValueError: when the state does not fit its world; then nothing is published.
        """
        self._model.positions(view)  # raises before anything is published
        topics = self._topics
        topics['odom'].publish(messages.odometry, view, stamp, self.body)
        topics['pose'].publish(messages.pose, view, stamp)
        topics['imu'].publish(messages.imu, view, stamp, self.body)
        topics['joint_states'].publish(
            messages.joint_states, view, stamp, self.body, self._model)
        topics['wrench'].publish(messages.wrench, view, stamp, self.body)
        topics['wind'].publish(messages.wind, view, stamp)
        drawn = view.episode, view.conditions.tobytes()
        if drawn != self._told:
            self._told = drawn
            topics['conditions'].publish(
                messages.conditions, view, self.name, self._info.condition_names)
        self._markers.add(view)
        if view.begins or view.outcome or stamp - self._drawn_at >= MARKER_PERIOD:
            self._drawn_at = stamp
            topics['markers'].publish(self._marker_array, view, stamp)

    def transforms(self, view: RocketView, stamp: int) -> list[Any]:
        """Return the transforms of a state, which go into one message with those of others."""
        return messages.transforms(view, stamp, self.frames, self.body, self._model)

    def _marker_array(self, view: RocketView, stamp: int) -> MarkerArray:
        return messages.marker_array(self._markers.of(view), stamp, self._row, self.body)


class BridgePublishers:
    """Publishers of all viewed rockets, `/tf`, the scene and, when asked for, `/clock`."""

    def __init__(self, topics: Topics, rows: tuple[int, ...], prefix: str, clock: bool) -> None:
        """Create what does not depend on the world."""
        self._topics = topics
        self._rows = rows
        self._prefix = prefix
        self._rockets: dict[int, RocketPublishers] = {}
        self._ends = Ends()
        self._urdf = ''
        self._world = ''
        self._description = topics.open(String, 'robot_description', qos.LATCHED)
        self._scene = topics.open(MarkerArray, 'markers', qos.LATCHED)
        self._tf = topics.open(TFMessage, '/tf', qos.VIEWS)
        self._clock = topics.open(Clock, '/clock', qos.CLOCK) if clock else None

    def begin(self, info: WorldInfo, num_envs: int, stamp: int) -> None:
        """Start publishing a world of `num_envs` rockets, or a new description of the same."""
        model = vehicle_model(info)
        for row in self._rows:
            if row < num_envs and row not in self._rockets:
                self._rockets[row] = RocketPublishers(self._topics, row, self._prefix)
        for rocket in self._rockets.values():
            rocket.begin(info, model)
        self._info = info
        if info.world != self._world:
            self._world = info.world
            self._ends.clear()
        if (urdf := model.urdf()) != self._urdf:
            self._urdf = urdf
            self._description.publish(lambda: String(data=urdf))
        self._publish_scene(stamp)

    def publish(self, moment: Moment) -> None:
        """Publish the messages of a moment, the clock first."""
        self._topics.set_time(moment.stamp)
        if self._clock is not None:
            self._clock.publish(lambda: Clock(clock=conversion.time_of(moment.stamp)))
        for view in moment.rockets:
            if view.row in self._rockets:
                self._rockets[view.row].publish(view, moment.stamp)
        self._tf.publish(self._transforms, moment)
        ended = [view for view in moment.rockets if view.outcome]
        for view in ended:
            self._ends.add(view)
        if ended:
            self._publish_scene(moment.stamp)

    def _transforms(self, moment: Moment) -> TFMessage:
        return TFMessage(transforms=[
            transform for view in moment.rockets if view.row in self._rockets
            for transform in self._rockets[view.row].transforms(view, moment.stamp)])

    def _publish_scene(self, stamp: int) -> None:
        self._scene.publish(lambda: messages.marker_array(scene(self._info, self._ends), stamp))
