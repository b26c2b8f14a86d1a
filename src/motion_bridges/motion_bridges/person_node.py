"""Base of the bridges: a node that receives one person's pose and points, set by set."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from rclpy.parameter import Parameter
from sensor_msgs.msg import MultiDOFJointState, PointCloud2

from capture_rig.errors import InputError
from capture_rig.settings import setting
from mocap_packets.fit import FIRST_PERSON, ReferencePoints
from sagoma_ros.health import LOG_EVERY_S
from sagoma_ros.messages import to_ns
from sagoma_ros.node import SagomaNode
from sagoma_ros.packets import read_reference_points
from sagoma_ros.poses import read_motions
from sagoma_ros.qos import DEPTH, RESULT
from stick_figure.kinematics import stick_frames
from stick_figure.pose import JointMotion

Array = np.ndarray


@dataclass(frozen=True)
class PersonSettings:
    """Whose motion a bridge hands on."""

    person: str = setting("mocap", "where the person's topics are: mocap, or mocap/bodies/b0002", is_name=True)


@dataclass(frozen=True, eq=False)
class Instant:
    """One person at one instant: stamp of the frame set; (15, 3) m; (10, 3, 3) frames of the sticks in the world."""

    stamp_ns: int
    frame_id: str
    points_world: Array
    R_world_sticks: Array


class PersonNode(SagomaNode, ABC):
    """Calls :meth:`send` with every frame set in which the person has a pose. It starts by itself."""

    Name: ClassVar[str]
    Settings: ClassVar[type] = PersonSettings

    def __init__(self, **options: Any) -> None:
        super().__init__(self.Name, **options)
        if "autostart" not in self._parameter_overrides:  # nothing that has to wait for a supervisor
            self.set_parameters([Parameter("autostart", value=True)])
        self._closing: list[Callable[[], object]] = []
        self._half_heard: dict[int, dict[type, Any]] = {}  # by stamp: two topics have no common order
        self._active = False

    @abstractmethod
    def send(self, instant: Instant) -> None:
        """Hand an instant on; OSError and InputError are logged."""

    def configure(self) -> None:
        """Subscribe."""
        for kind, topic, read in (
            (MultiDOFJointState, "joint_rotations", lambda *said: read_motions(*said).get(FIRST_PERSON)),
            (PointCloud2, "reference_points", read_reference_points),
        ):
            name = f"{self.settings.person}/{topic}"
            heard = self.create_subscription(kind, name, partial(self._add, read, name), RESULT)
            self._closing.append(partial(self.destroy_subscription, heard))

    def activate(self) -> None:
        """Hand on from now on."""
        self._active = True

    def deactivate(self) -> None:
        """Hand on nothing."""
        self._active = False

    def cleanup(self) -> None:
        """Release all resources."""
        for close in self._closing:
            close()
        self._closing.clear()
        self._half_heard.clear()

    def _add(self, read: Callable[[Any, str], Any], topic: str, message: Any) -> None:
        """Add one of a set's two messages; pass on the complete set."""
        if not self._active:
            return
        stamp_ns = to_ns(message.header.stamp)
        heard = self._half_heard.get(stamp_ns, {})
        try:
            heard |= {type(part): part for part in [read(message, topic)] if part is not None}
            if len(heard) == 2:
                points, pose = heard[ReferencePoints].points_world, heard[JointMotion].pose
                self.send(Instant(stamp_ns, message.header.frame_id, points, stick_frames(pose)))
                self.health.tick(stamp_ns)
        except (InputError, OSError) as error:
            self.health.count("failed")
            self.get_logger().warning(str(error), throttle_duration_sec=LOG_EVERY_S)
        self._half_heard.pop(stamp_ns, None)
        if len(heard) == 1:
            self._half_heard[stamp_ns] = heard
            if len(self._half_heard) > DEPTH:
                del self._half_heard[next(iter(self._half_heard))]
