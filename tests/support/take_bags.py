"""Small bags as the graph records them, for tests of what is done with takes."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.serialization import serialize_message
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import String

from mocap_packets.fit import ReferencePoints
from sagoma_ros.images import silhouette_message
from sagoma_ros.messages import to_stamp
from sagoma_ros.packets import joint_state_message, packet_cloud
from sagoma_tools.recording.writer import OFFERED_LATCHED, BagWriter
from stick_figure.body import Body, format_body
from stick_figure.kinematics import forward
from stick_figure.pose import T_POSE_ANGLES, Pose
from stick_figure.skeleton import ANGLE_NAMES

EPOCH_NS, PERIOD_NS = 1_000_000_000_000_000_000, 20_000_000
LATENCY_NS = 30_000_000  # from a message's stamp until it is logged
TYPES = {
    "reference_points": "sensor_msgs/msg/PointCloud2",
    "joint_states": "sensor_msgs/msg/JointState",
    "torso": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "state": "diagnostic_msgs/msg/DiagnosticStatus",
}
CAMERAS = ("cam01", "cam02")
SIGMA_M = 0.01


def write_take(
    folder: Path,
    frames: int = 50,
    *,
    doubtful: range = range(0),
    lost: range = range(0),
    missing: Sequence[int] = (),
    masks: Mapping[str, np.ndarray] | None = None,
    prefixes: Sequence[str] = ("/mocap",),
) -> Path:
    """A take of a person in the T-pose who moves along y by 1 cm a frame, at 50 Hz, seen by two cameras.

    doubtful, lost : frames in these states. missing : frames that cam02 lacks and the tracker does not answer.
    masks : each camera's silhouette, else bytes that are none. prefixes : of each person's topics, who stands a metre
    before the last.
    """
    body = Body.from_stature(1.7)
    with BagWriter(folder) as bag:
        for prefix in prefixes:
            for kind, msgtype in TYPES.items():
                bag.add_topic(f"{prefix}/{kind}", msgtype)
        for camera in CAMERAS:
            bag.add_topic(f"/{camera}/silhouette/compressed", "sensor_msgs/msg/CompressedImage")
        for topic in ("/hull/frame_set", "/icp/fit", "/diagnostics"):
            bag.add_topic(topic, "diagnostic_msgs/msg/DiagnosticArray")
        bag.add_topic("/icp/body", "std_msgs/msg/String", OFFERED_LATCHED)

        def write(topic: str, stamp_ns: int, message: object) -> None:
            bag.write(topic, stamp_ns + LATENCY_NS, serialize_message(message))

        write("/icp/body", EPOCH_NS, String(data=format_body(body)))
        for frame in range(frames):
            stamp = EPOCH_NS + frame * PERIOD_NS
            absent = frame in missing
            for camera in CAMERAS[: 1 if absent else 2]:
                image = silhouette_message(masks[camera], stamp, camera) if masks else CompressedImage(data=b"x")
                image.header.stamp = to_stamp(stamp)
                write(f"/{camera}/silhouette/compressed", stamp, image)
            write("/hull/frame_set", stamp, report(stamp, "hull", missing="cam02" if absent else ""))
            if frame % 10 == 0:
                write("/diagnostics", stamp, camera_report(frame))
            if absent:
                continue
            write("/icp/fit", stamp, report(stamp, "icp"))
            state = "doubtful" if frame in doubtful else "lost" if frame in lost else "tracking"
            for ahead, prefix in enumerate(prefixes):
                for kind, message in zip(TYPES, person(body, [ahead, 0.01 * frame, 1.1], stamp, state), strict=True):
                    write(f"{prefix}/{kind}", stamp, message)
        bag.describe({"graph": {}})
    return folder


def person(body: Body, place_world: Sequence[float], stamp: int, state: str) -> tuple:
    """Points, angles, torso and state."""
    pose = Pose.from_angles(np.array(place_world), np.eye(3), T_POSE_ANGLES)
    points = ReferencePoints(forward(body, pose), np.tile(SIGMA_M**2 * np.eye(3), (15, 1, 1)), np.ones(15, bool))
    torso = PoseWithCovarianceStamped()
    torso.header.stamp = to_stamp(stamp)
    place, turn = torso.pose.pose.position, torso.pose.pose.orientation
    place.x, place.y, place.z = pose.position_world
    turn.x, turn.y, turn.z, turn.w = Rotation.from_matrix(pose.R_world_torso).as_quat()
    said = {"stamp_ns": str(stamp), **({"left arm": state} if state == "doubtful" else {})}
    status = DiagnosticStatus(message=state, values=[KeyValue(key=key, value=value) for key, value in said.items()])
    angles = joint_state_message(ANGLE_NAMES, T_POSE_ANGLES, np.zeros(18), stamp)
    return packet_cloud(points, stamp, "map"), angles, torso, status


def report(stamp: int, name: str, **values: str) -> DiagnosticArray:
    """A status with values, and the stamp of a frame set."""
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    array = DiagnosticArray(status=[DiagnosticStatus(name=name, values=pairs)])
    array.header.stamp = to_stamp(stamp)
    return array


def camera_report(frame: int) -> DiagnosticArray:
    """The diagnostics of cam01's client, which loses a frame in ten, and learns a background anew at frame 30."""
    texts = {
        "background": "good; 100 frames",
        "background_learned": "2026-11-22T18:00:00+00:00" if frame < 30 else "2026-11-22T18:05:00+00:00",
        "background_serial": "S1",
        "camera_serial": "S1",
        "camera_model": "Studio",
        "lost": str(100 + frame // 10),
        "incomplete": "0",
        "expected": str(1000 + frame),
    }
    return report(0, "/cam01/camera_client", **texts)
