"""Joint angles of the ISB, live: PERSON/isb_angles, sensor_msgs/JointState in radians."""

from __future__ import annotations

import sys

import numpy as np
from sensor_msgs.msg import JointState

from motion_export.isb_angles import angles_of_sticks
from sagoma_ros.messages import to_stamp
from sagoma_ros.process import run_node
from sagoma_ros.qos import RESULT

from .person_node import Array, Instant, PersonNode


class ContinuousAngles:
    """The angles of the ISB, each continuous from instant to instant.

    A shoulder's stay within half a turn of zero: whenever an arm swings through hanging, where it has no plane of
    elevation, that angle leaps by about half a turn, and following the nearest one would wind it up.
    """

    def __init__(self) -> None:
        self._last: Array = np.zeros(1)

    def update(self, R_world_sticks: Array) -> dict[str, float]:
        """Return each angle of the sticks' frames (10, 3, 3) by name, degrees, the turn nearest to the last one's."""
        angles = angles_of_sticks(R_world_sticks[None])
        values = np.concatenate(list(angles.values()))
        near = self._last * ["shoulder" not in name for name in angles]
        self._last = values - 360.0 * np.round((values - near) / 360.0)
        return dict(zip(angles, self._last.tolist(), strict=True))


class IsbAngles(PersonNode):
    """Publishes PERSON/isb_angles, sensor_msgs/JointState in radians, with the stamp of the frame set."""

    Name = "isb_angles"

    def configure(self) -> None:
        """Open the topic."""
        super().configure()
        self._angles = ContinuousAngles()
        self._publisher = self.create_publisher(JointState, f"{self.settings.person}/isb_angles", RESULT)
        self._closing.append(lambda: self.destroy_publisher(self._publisher))

    def send(self, instant: Instant) -> None:
        """Publish the angles of an instant."""
        angles = self._angles.update(instant.R_world_sticks)
        message = JointState(name=list(angles), position=np.deg2rad(list(angles.values())).tolist())
        message.header.stamp, message.header.frame_id = to_stamp(instant.stamp_ns), instant.frame_id
        self._publisher.publish(message)


def main(args: list[str] | None = None) -> None:
    """Entry point of the executable ``isb_angles``."""
    sys.exit(run_node(IsbAngles, args))


if __name__ == "__main__":
    main()
