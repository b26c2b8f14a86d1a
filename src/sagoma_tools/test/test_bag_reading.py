"""Bags of both kinds are read back byte for byte, sorted into frame sets, digested and compared; a recording survives
kill -9, a power cut and a full disk with at most a second lost."""

import errno
import hashlib
import os
import select
import shutil
import signal
import struct
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from sensor_msgs.msg import CameraInfo, CompressedImage, JointState
from std_msgs.msg import String

from capture_rig.errors import InputError
from sagoma_ros.qos import LATCHED
from sagoma_tools.cli import main
from sagoma_tools.recording.reader import (
    TYPES,
    bag_cameras,
    bag_digest,
    canonical_bytes,
    first_difference,
    input_topics,
    read_frame_sets,
    read_messages,
)
from sagoma_tools.recording.writer import CHUNK_BYTES, OFFERED, SYNC_S, BagWriter, recover_bag

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


def test_digest_is_of_length_and_bytes_of_each_message_and_compare_names_the_first_difference(tmp_path, capsys):
    topic = "/mocap/joint_states"
    messages = [joint_state(EPOCH_NS + k, 0.1 * k) for k in range(4)]
    changed = [*messages[:2], messages[2][:-1] + b"\xff", *messages[3:]]
    for name, content in (("a", messages), ("b", changed), ("same", messages), ("short", messages[:3])):
        write_joint_states(tmp_path / name, content)
    expected = hashlib.sha256(b"".join(struct.pack("<Q", len(m)) + m for m in messages)).hexdigest()
    assert bag_digest(tmp_path / "a")[topic].sha256 == expected
    for other, status, said in (
        ("same", 0, "identical       4 messages"),
        ("b", 1, f"{topic}: message 2 differs first, from byte {len(messages[2]) - 1} on"),
        ("short", 1, "short ends after 3 messages"),
    ):
        assert main(["compare", str(tmp_path / "a"), str(tmp_path / other)]) == status
        assert said in capsys.readouterr().out
    with BagWriter(tmp_path / "inputs") as writer:
        writer.add_topic("/cam01/camera_info", INFO)
    assert main(["compare", str(tmp_path / "inputs"), str(tmp_path / "inputs")]) == 2
    assert "neither bag holds" in capsys.readouterr().err


def test_bytes_between_the_fields_do_not_count(tmp_path):
    """The name "neck_x" and its terminator fill 7 bytes; the 8th is a gap before the next number."""
    clean = joint_state(EPOCH_NS, 0.5)
    gap = clean.index(b"neck_x") + 7
    dirty = clean[:gap] + b"\xaa" + clean[gap + 1 :]
    assert clean[gap] == 0
    for same in (dirty, dirty + b"\x08\0\0\0"):
        assert canonical_bytes(same, "sensor_msgs/msg/JointState") == clean
    write_joint_states(tmp_path / "clean", [clean])
    write_joint_states(tmp_path / "dirty", [dirty])
    assert bag_digest(tmp_path / "clean") == bag_digest(tmp_path / "dirty")
    assert first_difference(tmp_path / "clean", tmp_path / "dirty", "/mocap/joint_states") == ""
    assert canonical_bytes(b"\x00\x01\x00\x00rubbish", "sensor_msgs/msg/JointState").endswith(b"rubbish")


def test_bag_without_cameras_and_bag_to_be_replaced_are_input_errors(tmp_path):
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


# --- what is lost of a recording

TOPIC, TEXT = "/icp/body", "std_msgs/msg/String"
WRITER_TO_KILL = """
import sys, time
from sagoma_tools.recording.writer import BagWriter
writer = BagWriter(sys.argv[1])
writer.add_topic("/icp/body", "std_msgs/msg/String")
while True:
    now_ns = time.monotonic_ns()
    writer.write("/icp/body", now_ns, b"\\0\\1\\0\\0" + bytes(100))
    print(now_ns, flush=True)
    time.sleep(0.005)
"""
RECORDED = b"\0\1\0\0" + bytes(100)
LARGE = 1 << 16  # bytes of a message that the headers and the index of a file do not reach


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 4 MiB."""
    mount = tmp_path / "disk"
    mount.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=4M", "sagoma-test", str(mount)]
    if os.geteuid() != 0 or subprocess.run(command, capture_output=True).returncode != 0:
        pytest.skip("a small disk cannot be mounted here: that needs root and CAP_SYS_ADMIN")
    yield mount
    subprocess.run(["umount", "--lazy", str(mount)], check=True)


def opened(bag):
    writer = BagWriter(bag)
    writer.add_topic(TOPIC, TEXT)
    return writer


def test_a_killed_recorder_loses_less_than_a_second(tmp_path):
    command = [sys.executable, "-c", WRITER_TO_KILL, str(tmp_path / "bag")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, bufsize=1) as process:
        first_ns = int(process.stdout.readline())
        written = [first_ns]
        while written[-1] - first_ns < 3 * SYNC_S * 1e9:
            written.append(int(process.stdout.readline()))
        process.send_signal(signal.SIGKILL)
        written += [int(line) for line in process.stdout if line.endswith("\n")]
    with pytest.raises(InputError, match="sagoma recover"):
        list(read_messages(tmp_path / "bag"))
    recovery = recover_bag(tmp_path / "bag", tmp_path / "mended")
    read = [message.log_ns for message in read_messages(tmp_path / "mended")]
    assert read == written[: len(read)] and recovery.counts == {TOPIC: len(read)}
    # by the writer's own clock; the pauses that a busy machine gives it are no loss
    lost = [later - earlier for earlier, later in zip(written[len(read) - 1 :], written[len(read) :], strict=False)]
    assert sum(min(gap, 50_000_000) for gap in lost) < 1e9


def test_after_a_power_cut_there_is_what_was_synced_at_most_a_second_ago(tmp_path, monkeypatch):
    """The disk is sure to have of a file what it held when fsync returned: the rest is cut off here."""
    on_disk, synced = [0], threading.Condition()
    fsync = os.fsync

    def remember(descriptor):
        fsync(descriptor)
        if os.readlink(f"/proc/self/fd/{descriptor}") == str(tmp_path / "bag" / "bag.mcap"):
            with synced:
                on_disk.append(os.fstat(descriptor).st_size)
                synced.notify_all()

    monkeypatch.setattr(os, "fsync", remember)
    writer = opened(tmp_path / "bag")
    large = b"\0\1\0\0" + np.random.default_rng(0).bytes(LARGE)
    writer.write(TOPIC, 1, large)
    with synced:  # nobody asks for it: the bag syncs by itself
        assert synced.wait_for(lambda: on_disk[-1] > LARGE, 60.0)
    writer.write(TOPIC, 2, RECORDED)  # has not been synced when the power goes
    shutil.copytree(tmp_path / "bag", tmp_path / "cut", ignore=shutil.ignore_patterns(".*"))
    os.truncate(tmp_path / "cut" / "bag.mcap", next(size for size in on_disk if size > LARGE))
    writer.close()
    recover_bag(tmp_path / "cut", tmp_path / "mended")
    assert 1 in [message.log_ns for message in read_messages(tmp_path / "mended")]
    assert SYNC_S <= 0.5


def test_a_disk_that_fails_ends_the_bag_and_what_was_there_is_recovered(tmp_path, monkeypatch):
    def fail(*arguments):
        raise OSError(errno.EIO, "Input/output error")

    writer = opened(tmp_path / "bag")
    for number in range(6):  # the first chunk is closed by its size
        writer.write(TOPIC, number, b"\0\1\0\0" + bytes(CHUNK_BYTES // 4))
    monkeypatch.setattr(writer._mcap, "add_message", fail)
    with pytest.raises(InputError, match=r"the recording has ended \(Input/output error\).*sagoma recover"):
        for number in range(6, 20):
            writer.write(TOPIC, number, RECORDED + bytes(CHUNK_BYTES // 4))
    writer.close()
    assert 4 <= recover_bag(tmp_path / "bag", tmp_path / "mended").counts[TOPIC] <= 6


def test_record_on_a_full_disk_says_what_was_saved_and_ends_with_status_1(small_disk, link, tmp_path):
    publisher = link.node.create_publisher(String, TOPIC, LATCHED)
    command = [sys.executable, "-m", "sagoma_tools.cli", "record", str(small_disk / "bag")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert "recording into" in process.stdout.readline()
        text = "x" * (200 << 10)
        while process.poll() is None and not select.select([process.stderr], [], [], 0.0)[0]:
            publisher.publish(String(data=text))
            time.sleep(0.01)  # paces the load; nothing is awaited
        said, told = process.communicate(timeout=60.0)
    assert process.returncode == 1, told
    assert "the recording has ended (No space left on device)" in told and "Traceback" not in told
    counted = int(next(line.split()[0] for line in said.splitlines() if TOPIC in line))
    assert f"{sum(int(line.split()[0]) for line in said.splitlines() if line.split()[0].isdigit())} messages" in told
    saved = recover_bag(small_disk / "bag", tmp_path / "mended").counts[TOPIC]
    assert 0 < saved <= counted and saved * len(text) > 2 << 20


COMPRESSIONS = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "": CompressionType.NONE}


def write_compressed(bag, compression, messages):
    """Write a bag with chunks of four messages each as `ros2 bag record` compresses them, and no end."""
    bag.mkdir()
    mcap = bag / f"{bag.name}.mcap"
    with mcap.open("wb") as file:
        writer = McapWriter(file, compression=COMPRESSIONS[compression])
        writer.start()
        schema = writer.register_schema(TEXT, "ros2msg", b"string data")
        channel = writer.register_channel(TOPIC, "cdr", schema)
        for number, message in enumerate(messages):
            writer.add_message(channel, number, message, number)
            if number % 4 == 3:
                writer.flush()
    return mcap


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_of_a_bag_cut_or_damaged_in_a_chunk_that_chunk_alone_is_lost(tmp_path, compression):
    draw = np.random.default_rng(0)
    messages = [b"\0\1\0\0" + draw.bytes(1 << 16) for _ in range(12)]
    mcap = write_compressed(tmp_path / "bag", compression, messages)
    whole = mcap.read_bytes()
    os.truncate(mcap, len(whole) - (1 << 16))
    with pytest.raises(InputError, match="sagoma recover"):
        list(read_messages(tmp_path / "bag"))
    recovery = recover_bag(tmp_path / "bag", tmp_path / "mended")
    read = [message.data for message in read_messages(tmp_path / "mended")]
    assert read == messages[:8] and recovery.damaged_chunks == 0 and recovery.unread_bytes > 0
    place = whole.index(messages[5][1000:1020])  # random bytes: no compression changes them
    mcap.write_bytes(whole[:place] + bytes(4) + whole[place + 4 :])
    recovery = recover_bag(tmp_path / "bag", tmp_path / "repaired")
    assert recovery.damaged_chunks == 1 and "1 damaged chunks" in str(recovery)
    assert [m.data for m in read_messages(tmp_path / "repaired")] == messages[:4] + messages[8:]
