"""Bags of both kinds are read back byte for byte, sorted into frame sets, digested and compared."""

import hashlib
import struct

import pytest
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from sensor_msgs.msg import CameraInfo, CompressedImage, JointState

from capture_rig.errors import InputError
from sagoma_tools.recording.reader import (
    TYPES,
    bag_cameras,
    bag_digest,
    canonical_bytes,
    first_difference,
    header_stamp_ns,
    input_topics,
    read_frame_sets,
    read_messages,
)
from sagoma_tools.recording.writer import OFFERED, BagWriter

PERIOD_NS = 16_666_667
EPOCH_NS = 1_700_000_000_123_456_789
SILHOUETTE, INFO = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo"


def stamped(message, stamp_ns):
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    return message


def silhouette(stamp_ns, content=b"png"):
    return serialize_message(stamped(CompressedImage(format="mono8; png compressed mono8", data=content), stamp_ns))


def joint_state(stamp_ns, angle):
    message = JointState(name=["neck_x"], position=[angle], velocity=[0.0], effort=[0.0])
    return canonical_bytes(serialize_message(stamped(message, stamp_ns)), "sensor_msgs/msg/JointState")


@pytest.fixture(scope="module", params=[StoragePlugin.MCAP, StoragePlugin.SQLITE3], ids=["mcap", "sqlite3"])
def two_camera_bag(request, tmp_path_factory):
    """Two cameras, 5 sets; camera_info logged after the silhouette; cam02 stamps 1 ms later and loses frame 3."""
    bag = tmp_path_factory.mktemp("two") / "bag"
    written = []
    with Writer(bag, version=9, storage_plugin=request.param) as writer:
        connections = {}
        for camera in ("cam02", "cam01"):
            for suffix, msgtype in (("silhouette/compressed", SILHOUETTE), ("camera_info", INFO)):
                topic = f"/{camera}/{suffix}"
                connections[topic] = writer.add_connection(
                    topic, msgtype, typestore=TYPES, offered_qos_profiles=(OFFERED,)
                )
        for k in range(5):
            for camera, delay_ns in (("cam02", 1_000_000), ("cam01", 0)):
                if (camera, k) == ("cam02", 3):
                    continue
                stamp_ns = EPOCH_NS + k * PERIOD_NS + delay_ns
                info = serialize_message(stamped(CameraInfo(width=640, height=480), stamp_ns))
                for topic, data, late in (
                    (f"/{camera}/silhouette/compressed", silhouette(stamp_ns, bytes([k, delay_ns % 256])), 0),
                    (f"/{camera}/camera_info", info, 50),
                ):
                    log_ns = stamp_ns + 2_000_000 + late
                    writer.write(connections[topic], log_ns, data)
                    written.append((log_ns, topic, data))
    return bag, sorted(written)


def test_bytes_and_log_times_read_back_equal_what_was_written_and_cameras_are_in_order(two_camera_bag):
    bag, written = two_camera_bag
    assert [(m.log_ns, m.topic, m.data) for m in read_messages(bag)] == written
    assert bag_cameras(bag) == ("cam01", "cam02")
    suffixes = ("camera_info", "silhouette/compressed")
    assert input_topics(bag) == tuple(f"/{camera}/{suffix}" for camera in ("cam01", "cam02") for suffix in suffixes)


def test_frame_sets_pair_cameras_by_stamp_and_name_the_missing_one(two_camera_bag):
    bag, _ = two_camera_bag
    sets = list(read_frame_sets(bag, tolerance_ns=PERIOD_NS // 2))
    means_ns = [0 if k == 3 else 500_000 for k in range(5)]  # of both cameras' delays
    assert [s.stamp_ns for s in sets] == [EPOCH_NS + k * PERIOD_NS + mean_ns for k, mean_ns in enumerate(means_ns)]
    assert [s.missing for s in sets] == [(), (), (), ("cam02",), ()]
    for k, frame_set in enumerate(sets):
        for camera, messages in frame_set.frames.items():
            assert [m.topic.split("/", 2)[2] for m in messages] == ["camera_info", "silhouette/compressed"]
            assert {m.stamp_ns for m in messages} == {frame_set.stamps_ns[camera]}
            assert messages[1].data[-2] == k  # the mask of this very frame


def test_header_stamp_is_read_without_deserializing():
    assert header_stamp_ns(joint_state(EPOCH_NS, 0.5)) == EPOCH_NS
    big_endian = b"\x00\x00\x00\x00" + struct.pack(">iI", 7, 9)
    assert header_stamp_ns(big_endian) == 7_000_000_009


def test_digest_is_of_length_and_bytes_of_each_message_and_the_first_difference_names_message_and_byte(tmp_path):
    topic = "/mocap/joint_states"
    messages = [joint_state(EPOCH_NS + k, 0.1 * k) for k in range(4)]
    changed = [*messages[:2], messages[2][:-1] + b"\xff", *messages[3:]]
    for name, content in (("a", messages), ("b", changed), ("same", messages), ("short", messages[:3])):
        write_joint_states(tmp_path / name, content)
    expected = hashlib.sha256(b"".join(struct.pack("<Q", len(m)) + m for m in messages)).hexdigest()
    assert bag_digest(tmp_path / "a")[topic].sha256 == expected
    assert first_difference(tmp_path / "a", tmp_path / "same", topic) is None
    found = first_difference(tmp_path / "a", tmp_path / "b", topic)
    assert (found.index, found.byte) == (2, len(messages[2]) - 1)
    found = first_difference(tmp_path / "a", tmp_path / "short", topic)
    assert (found.index, found.byte, found.count_a, found.count_b) == (3, None, 4, 3)


def test_bytes_between_the_fields_do_not_count(tmp_path):
    """The name "neck_x" and its terminator fill 7 bytes; the 8th is a gap before the next number."""
    clean = joint_state(EPOCH_NS, 0.5)
    gap = clean.index(b"neck_x") + 7
    dirty = clean[:gap] + b"\xaa" + clean[gap + 1 :]
    assert clean[gap] == 0 and canonical_bytes(dirty, "sensor_msgs/msg/JointState") == clean
    write_joint_states(tmp_path / "clean", [clean])
    write_joint_states(tmp_path / "dirty", [dirty])
    assert bag_digest(tmp_path / "clean") == bag_digest(tmp_path / "dirty")
    assert first_difference(tmp_path / "clean", tmp_path / "dirty", "/mocap/joint_states") is None
    assert canonical_bytes(b"\x00\x01\x00\x00rubbish", "sensor_msgs/msg/JointState").endswith(b"rubbish")


def test_missing_bag_bag_without_cameras_and_bag_to_be_replaced_are_input_errors(tmp_path):
    with pytest.raises(InputError, match="there is no such bag"):
        list(read_messages(tmp_path / "nothing"))
    write_joint_states(tmp_path / "outputs_only", [joint_state(EPOCH_NS, 0.0)])
    with pytest.raises(InputError, match="silhouette/compressed"):
        input_topics(tmp_path / "outputs_only")
    with pytest.raises(InputError, match="exists already"):
        BagWriter(tmp_path / "outputs_only")


def test_log_times_never_go_back_when_the_clock_does(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/mocap/joint_states", "sensor_msgs/msg/JointState")
        for log_ns in (50, 40, 60):
            writer.write("/mocap/joint_states", log_ns, joint_state(log_ns, 0.0))
    read = [(m.log_ns, m.stamp_ns) for m in read_messages(tmp_path / "bag")]
    assert read == [(50, 50), (50, 40), (60, 60)]


def write_joint_states(bag, messages):
    with BagWriter(bag) as writer:
        writer.add_topic("/mocap/joint_states", "sensor_msgs/msg/JointState")
        for k, data in enumerate(messages):
            writer.write("/mocap/joint_states", EPOCH_NS + k * PERIOD_NS, data)
