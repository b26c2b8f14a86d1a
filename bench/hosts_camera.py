"""One camera host of bench/hosts.py: sends a clip's silhouettes as a camera client does, at the rate of a camera.

    python bench/hosts_camera.py CLIP CAMERA HZ [--clock S]

CLIP is a pickle of :func:`write_clip`. The exposures of all cameras are at the whole periods of the machine's clock, as
if a cable triggered them; ``--clock`` is how far ahead the clock is by which this one stamps them. Messages are
stamped and published as a camera client does: camera_info with every silhouette, reliable.
"""

from __future__ import annotations

import argparse
import pickle
import time
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage

from capture_rig import Rig
from sagoma_ros.images import camera_info_message, silhouette_message
from sagoma_ros.messages import NS_PER_S, to_stamp
from sagoma_ros.qos import SILHOUETTE_PUBLISHER
from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.topics import camera_topics

READY = "sending"


def write_clip(path: Path, rig: Rig, frames: list[dict[str, Any]]) -> int:
    """Write the serialised messages of every camera's masks; return the median size of a silhouette, bytes."""
    document = {}
    for camera in rig.cameras:
        canvas, frame_id = camera.undistorted_view().camera, f"{camera.name}_optical"
        masks = [serialize_message(silhouette_message(masks[camera.name], 0, frame_id)) for masks in frames]
        document[camera.name] = serialize_message(camera_info_message(canvas, 0, frame_id)), masks
    path.write_bytes(pickle.dumps(document))
    sizes = sorted(len(mask) for _, masks in document.values() for mask in masks)
    return sizes[len(sizes) // 2]


def main() -> None:
    """Send until killed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clip", type=Path)
    parser.add_argument("camera")
    parser.add_argument("hz", type=float)
    parser.add_argument("--clock", type=float, default=0.0)
    arguments = parser.parse_args()
    info_bytes, mask_bytes = pickle.loads(arguments.clip.read_bytes())[arguments.camera]
    info = deserialize_message(info_bytes, CameraInfo)
    masks = [deserialize_message(mask, CompressedImage) for mask in mask_bytes]
    info_topic, mask_topic = (topic.name for topic in camera_topics(arguments.camera))
    with RosLink(f"camera_{arguments.camera}") as link:
        infos = link.node.create_publisher(CameraInfo, info_topic, SILHOUETTE_PUBLISHER)
        silhouettes = link.node.create_publisher(CompressedImage, mask_topic, SILHOUETTE_PUBLISHER)
        print(READY, flush=True)
        frame, ahead_ns = int(time.time() * arguments.hz) + 1, round(arguments.clock * NS_PER_S)
        while True:
            exposed_ns = round(frame * NS_PER_S / arguments.hz)
            time.sleep(max(exposed_ns - time.time_ns(), 0) / NS_PER_S)
            mask = masks[frame % len(masks)]
            info.header.stamp = mask.header.stamp = to_stamp(exposed_ns + ahead_ns)
            infos.publish(info)
            silhouettes.publish(mask)
            frame += 1


if __name__ == "__main__":
    main()
