"""The rig's calibration from running cameras: their pictures are published here."""

import threading
import time
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest
from calibration_room import held, on_floor, picture, three_cameras
from sensor_msgs.msg import Image

from capture_rig.errors import InputError
from rig_calibration.boards.board import Checkerboard
from rig_calibration.extrinsics import board_frames as progress
from sagoma_ros.images import image_message
from sagoma_ros.qos import SILHOUETTE_PUBLISHER
from sagoma_tools.calibration.rig_live import LiveSources, find_topics, grab
from sagoma_tools.graph.ros_link import RosLink

BOARD = Checkerboard(7, 4, (0.12, 0.12))
CAMERAS = three_cameras()
POSES = [
    held(BOARD, (0.1 * k - 0.2, 0.1 - 0.05 * k, 0.2 + 0.05 * k), (0.05 * k - 0.1, 0.05, 0.1 * k)) for k in range(4)
]
PERIOD_S = 0.15


@pytest.fixture(scope="module")
def published():
    """All cameras publish one instant again and again: the board on the floor or, once ``carried``, in the room."""
    floor = {name: [picture(camera, BOARD, on_floor(BOARD))] for name, camera in CAMERAS.items()}
    carried = {name: [picture(camera, BOARD, T, k) for k, T in enumerate(POSES)] for name, camera in CAMERAS.items()}
    state, number = SimpleNamespace(carried=False), count()

    def publish():
        pictures, stamp_ns, k = carried if state.carried else floor, time.time_ns(), next(number)
        for name, publisher in publishers.items():
            image = pictures[name][k % len(pictures[name])]
            publisher.publish(image_message(image, stamp_ns, f"{name}_optical"))

    with RosLink("published_cameras") as link:
        topics = {name: f"/{name}/image_raw" for name in CAMERAS}
        publishers = {n: link.node.create_publisher(Image, topic, SILHOUETTE_PUBLISHER) for n, topic in topics.items()}
        link.node.create_timer(PERIOD_S, publish)
        yield state


def test_cameras_are_found_and_deliver_their_pictures_and_one_that_does_not_is_named(published, link):
    topics = find_topics(link.node, ())
    assert topics == {name: f"/{name}/image_raw" for name in CAMERAS}
    shots = grab(link.node, topics, 2)
    assert {name: len(shot) for name, shot in shots.items()} == dict.fromkeys(CAMERAS, 2)
    assert np.array_equal(shots["cam02"][0][1], picture(CAMERAS["cam02"], BOARD, on_floor(BOARD)))
    with pytest.raises(InputError, match=r"no node publishes /cam09/image_raw.*cam01, cam02, cam03"):
        find_topics(link.node, ["cam01", "cam09"], timeout_s=0.5)


def test_floor_and_carried_board_are_seen_live_in_common_frames(published, link, monkeypatch):
    for name, few in (("ENOUGH_SHARED", 3), ("ENOUGH_FRAMES", 5)):
        monkeypatch.setattr(progress, name, few)
    asked: list[str] = []

    def ask(what):
        asked.append(what)
        published.carried = "Carry" in what

    sources = LiveSources(link.node, ("cam01", "cam02", "cam03"), (), True, ask, threading.Event())
    floor = sources.detect_floor(BOARD, {})
    moving = sources.detect_moving(BOARD, CAMERAS)
    assert [what.split()[0] for what in asked] == ["Lay", "Carry"]
    assert all(len(seen.detections) == seen.examined for seen in floor.values())
    frames = [{s.frame_index for s in moving[name].detections} for name in CAMERAS]
    assert len(frames[0] & frames[1] | frames[1] & frames[2] | frames[0] & frames[2]) >= 5
    for name, camera in CAMERAS.items():
        seen = moving[name].detections[-1].pixels
        true = [camera.project(BOARD.corners_board @ T[:3, :3].T + T[:3, 3]) for T in POSES]
        assert min(np.abs(seen - pixels).max() for pixels in true) < 1.0, "corners of one of the published poses"
