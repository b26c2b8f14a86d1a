"""Bags of images that another writer made, as drivers of cameras without trigger fill them, become sessions."""

import cv2
import numpy as np
import pytest
from rclpy.qos import qos_profile_sensor_data
from rosbags.rosbag2 import StoragePlugin, Writer
from sensor_msgs.msg import CompressedImage, Image
from tools_waiting import until

from capture_rig.camera_info_file import read_camera_info
from capture_rig.errors import InputError
from capture_rig.rig import load_rig, save_rig
from capture_rig.session import load_session
from mocap_pipeline.session_footage import images_of
from sagoma_ros.images import decode_image
from sagoma_ros.messages import to_ns
from sagoma_tools.cli import main
from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.importers.image_bag import frame_sets, import_bag
from sagoma_tools.recording.reader import TYPES
from virtual_studio.rig import ring

EPOCH_NS, PERIOD_NS, LATER_NS, FRAMES = 1_700_000_000_123_456_789, 33_333_333, 4_000_000, 5
LOST, CAMERAS = 3, ("cam01", "cam02")
IMAGE, COMPRESSED, INFO = (f"sensor_msgs/msg/{kind}" for kind in ("Image", "CompressedImage", "CameraInfo"))
TOPICS = {"cam01": "/driver/cam01/image_raw", "cam02": "/driver/cam02/image_raw/compressed"}


def of(kind, *values):
    return TYPES.types[kind](*values)


def header(stamp_ns):
    return of("std_msgs/msg/Header", of("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9)), "optical")


def picture(camera, k):
    """Noise: grey of the first camera, coloured of the second."""
    shape = (480, 640) if camera == "cam01" else (480, 640, 3)
    return np.random.default_rng([k, int(camera[-1])]).integers(0, 256, shape, np.uint8)


def image(camera, k, stamp_ns):
    shown = picture(camera, k)
    if camera == "cam01":
        rows = np.pad(shown, ((0, 0), (0, 8)))  # as cameras send rows of a multiple of some bytes
        return of(IMAGE, header(stamp_ns), 480, 640, "mono8", 0, 648, rows.ravel())
    return of(COMPRESSED, header(stamp_ns), "png", cv2.imencode(".png", shown)[1])


def info(rig, name, stamp_ns):
    camera, region = rig.camera(name), of("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
    matrices = camera.D, camera.K.ravel(), np.eye(3).ravel(), np.zeros(12)
    return of(INFO, header(stamp_ns), camera.height, camera.width, "plumb_bob", *matrices, 0, 0, region)


def write_bag(path, frames=FRAMES):
    """Two cameras without trigger; the second is 4 ms late, and has lost its image LOST."""
    rig = ring(1)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:

        def write(topic, kind, messages):
            connection = writer.add_connection(topic, kind, typestore=TYPES)
            for stamp_ns, message in messages:
                writer.write(connection, stamp_ns + 3_000_000, TYPES.serialize_cdr(message, kind))

        for name, kind, later_ns in (("cam01", IMAGE, 0), ("cam02", COMPRESSED, LATER_NS)):
            stamps = [EPOCH_NS + k * PERIOD_NS + later_ns for k in range(frames)]
            kept = [k for k in range(frames) if (name, k) != ("cam02", LOST)]
            write(TOPICS[name], kind, [(stamps[k], image(name, k, stamps[k])) for k in kept])
            write(f"/driver/{name}/camera_info", INFO, [(ns, info(rig, name, ns)) for ns in stamps[:1]])
    return path


@pytest.fixture
def rig_file(tmp_path):
    save_rig(ring(1), tmp_path / "rig.yaml")
    return tmp_path / "rig.yaml"


def test_session_has_every_pixel_and_every_stamp_of_the_bag(tmp_path, rig_file, capsys):
    bag, folder = write_bag(tmp_path / "bag"), tmp_path / "session"
    room = write_bag(tmp_path / "room", frames=3)
    assert main(["import", "bag", str(bag), str(folder), "--rig", str(rig_file), "--background", str(room)]) == 0
    said = capsys.readouterr().out
    assert "4 frames at 30 Hz, images of a frame up to 4.0 ms apart, 1 left out" in said
    session, kept = load_session(folder), [k for k in range(FRAMES) if k != LOST]
    assert session.rig.names == CAMERAS == tuple(session.backgrounds) and session.fps == pytest.approx(30.0, abs=1e-3)
    for shown, k in zip(images_of(session.videos), kept, strict=True):
        for camera in CAMERAS:
            np.testing.assert_array_equal(shown[camera], picture(camera, k))
    for frame, k in enumerate(kept):
        expected = {"cam01": EPOCH_NS + k * PERIOD_NS, "cam02": EPOCH_NS + k * PERIOD_NS + LATER_NS}
        assert session.stamps_ns(EPOCH_NS, frame) == expected


def test_without_a_rig_the_lenses_of_the_drivers_are_written(tmp_path):
    folder = tmp_path / "session"
    said = import_bag(write_bag(tmp_path / "bag"), folder)
    assert said[:2] == [f"{name}: {topic}" for name, topic in TOPICS.items()] and not (folder / "rig.yaml").exists()
    for camera in ring(1).cameras:
        lens = read_camera_info(folder / "lenses" / f"{camera.name}.yaml", camera.name)
        np.testing.assert_allclose(lens.K, camera.K)
        np.testing.assert_allclose(lens.D, camera.D)


def test_cameras_that_no_topic_names_are_refused_until_they_are_given_theirs(tmp_path, rig_file):
    bag, other = write_bag(tmp_path / "bag"), tmp_path / "other.yaml"
    other.write_text(rig_file.read_text().replace("cam02", "left"))
    with pytest.raises(InputError, match=f"no images of left; topics of images: {TOPICS['cam01']}, ") as caught:
        import_bag(bag, tmp_path / "session", other)
    assert "--camera left=/" in caught.value.remedy and not (tmp_path / "session").exists()
    said = import_bag(bag, tmp_path / "session", other, {"left": TOPICS["cam02"]})
    assert said[:2] == [f"cam01: {TOPICS['cam01']}", f"left: {TOPICS['cam02']}"]
    assert load_rig(tmp_path / "session" / "rig.yaml").names == ("cam01", "left")


def test_frames_hold_images_that_belong_together_however_cameras_drift_and_jitter():
    first = 10**9 + np.arange(200) * 33_000_000
    second = 10**9 + np.arange(198) * 33_100_000 - 7_000_000  # 0.3 % slower: from 7 ms early to 13 ms late
    sets_ns, period_ns = frame_sets([first, second])
    assert period_ns == 33_000_000 and sets_ns.tolist() == np.stack([first[:198], second], axis=1).tolist()
    jitter_ns = np.random.default_rng(4).integers(-2_000_000, 2_000_000, (3, 200))
    phases_ns = np.array([[0], [16_500_000], [30_000_000]])
    stamps_ns = first + phases_ns + jitter_ns
    sets_ns, _ = frame_sets(list(np.delete(one, lost) for one, lost in zip(stamps_ns, (50, 100, 150), strict=True)))
    assert len(sets_ns) in (196, 197)  # 3 are lost, and the first or last image may have no partner
    assert np.ptp(np.ptp(sets_ns, axis=1)) < 8_000_000 and np.ptp(sets_ns, axis=1).max() < 24_000_000
    with pytest.raises(InputError, match="no two cameras' images are of the same time"):
        frame_sets([first, second + 3600 * 10**9])


def test_replay_plays_the_images_to_whoever_takes_them(tmp_path, capsys):
    bag, heard = write_bag(tmp_path / "bag"), {topic: [] for topic in TOPICS.values()}
    with RosLink("camera_clients") as link:
        for topic, kind in zip(TOPICS.values(), (Image, CompressedImage), strict=True):
            link.node.create_subscription(kind, topic, lambda m, t=topic: heard[t].append(m), qos_profile_sensor_data)
        assert main(["replay", str(bag), "--rate", "10"]) == 0
        until(lambda: sum(map(len, heard.values())) >= 2 * FRAMES - 1)
    assert f"played {2 * FRAMES + 1} messages on 4 topics" in capsys.readouterr().out  # with a camera_info of each
    assert [to_ns(m.header.stamp) for m in heard[TOPICS["cam01"]]] == [EPOCH_NS + k * PERIOD_NS for k in range(FRAMES)]
    np.testing.assert_array_equal(decode_image(heard[TOPICS["cam02"]][-1], ""), picture("cam02", FRAMES - 1))
