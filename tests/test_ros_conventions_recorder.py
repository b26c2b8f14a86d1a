"""The recorder takes what is asked for, of whatever nodes, and its bags say of what types they are."""

import struct
import sys
import types

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import String

from sagoma_ros.messages import to_stamp
from sagoma_ros.qos import LATCHED, RESULT
from sagoma_tools.cli import main
from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.topics import LOSSLESS, Topic
from sagoma_tools.recording import recorder as recorder_module
from sagoma_tools.recording.reader import TYPES, bag_topics, read_messages, read_provenance
from sagoma_tools.recording.recorder import AskedTopics, Recorder, TimeJumpDetector, is_known, matches_any

PATIENCE_S = 30.0
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.fixture
def link():
    with RosLink("recorder_test") as link:
        yield link


@pytest.fixture
def others():
    """The other nodes of the graph."""
    with RosLink("others") as link:
        yield link


@pytest.mark.parametrize(
    ("asked", "taken"),
    [
        (["/tf"], {"/tf"}),  # not /tf_static, which only begins alike
        (["humans"], {"/humans/bodies/tracked", "/humans/bodies/b0001/joint_states"}),
        (["/cam01/", "/tf_static"], {"/cam01/camera_info", "/tf_static"}),
    ],
)
def test_names_stand_for_a_topic_or_for_all_below(asked, taken):
    graph = ["/tf", "/tf_static", "/humans/bodies/tracked", "/humans/bodies/b0001/joint_states", "/cam01/camera_info"]
    assert set(filter(matches_any(asked), graph)) == taken


def test_asked_topics_are_recorded_as_they_are_offered_and_nothing_else(link, others, tmp_path):
    kept = others.node.create_publisher(String, "/humans/bodies/b0001/urdf", LATCHED)
    kept.publish(String(data="said before the recording"))
    others.node.create_publisher(JointState, "/mocap/joint_states", RESULT)
    recorder = Recorder(link.node, tmp_path / "bag", ())
    asked = AskedTopics(link.node, matches_any(["/humans", "/cam01"]), lambda topic, kind: None)
    recorder.follow(asked.new)
    assert recorder.wait_for_count("/humans/bodies/b0001/urdf", 1, PATIENCE_S)
    late = others.node.create_publisher(Image, "/cam01/image_raw", BEST_EFFORT)  # as camera drivers publish
    assert not recorder.wait_for_publishers(["/cam01/image_raw"], PATIENCE_S)
    late.publish(Image(height=1, width=2, step=2, encoding="mono8", data=b"\1\2"))
    assert recorder.wait_for_count("/cam01/image_raw", 1, PATIENCE_S)
    assert set(recorder.close()) == {"/humans/bodies/b0001/urdf", "/cam01/image_raw"}
    qos = {topic.name: topic for topic in asked_again(link)}
    assert qos["/humans/bodies/b0001/urdf"].qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert qos["/cam01/image_raw"].qos.reliability == ReliabilityPolicy.BEST_EFFORT
    assert sum(1 for _ in read_messages(tmp_path / "bag")) == 2


def asked_again(link):
    return AskedTopics(link.node, matches_any(["/humans", "/cam01"]), lambda topic, kind: None).new()


def test_topic_whose_type_is_not_installed_is_named_once_and_left_out(link, others, monkeypatch):
    others.node.create_publisher(String, "/tf", RESULT)
    monkeypatch.setattr(recorder_module, "is_known", lambda msgtype: False)
    left_out = []
    asked = AskedTopics(link.node, matches_any(["/tf"]), lambda *what: left_out.append(what))
    while not left_out:
        assert asked.new() == []
    assert asked.new() == [] and left_out == [("/tf", "std_msgs/msg/String")]


def test_definition_of_a_type_that_is_installed_is_learned(tmp_path, monkeypatch):
    """A stand-in of hri_msgs: a package with a message of its own, in an installation of ROS."""
    (tmp_path / "share/ament_index/resource_index/packages").mkdir(parents=True)
    (tmp_path / "share/ament_index/resource_index/packages/crowd_msgs").touch()
    (tmp_path / "share/crowd_msgs/msg").mkdir(parents=True)
    (tmp_path / "share/crowd_msgs/msg/Ids.msg").write_text(
        "std_msgs/Header header\nstring[] ids\ncrowd_msgs/Size[] sizes\n"
    )
    (tmp_path / "share/crowd_msgs/msg/Size.msg").write_text("float64 metres\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert not is_known("crowd_msgs/msg/Ids")  # there, but not its Python module
    module = types.SimpleNamespace(Ids=object, Size=object)
    monkeypatch.setitem(sys.modules, "crowd_msgs", types.SimpleNamespace(msg=module))
    monkeypatch.setitem(sys.modules, "crowd_msgs.msg", module)
    assert is_known("crowd_msgs/msg/Ids") and "crowd_msgs/msg/Size" in TYPES.fielddefs
    assert TYPES.hash_rihs01("crowd_msgs/msg/Ids").startswith("RIHS01_")


def test_channels_of_a_bag_carry_the_hash_of_their_type(link, others, tmp_path):
    publisher = others.node.create_publisher(JointState, "/probe", LOSSLESS)
    recorder = Recorder(link.node, tmp_path / "bag", [Topic("/probe", "sensor_msgs/msg/JointState")])
    assert not recorder.wait_for_publishers(["/probe"], PATIENCE_S)
    publisher.publish(JointState(name=["neck_x"]))
    assert recorder.wait_for_count("/probe", 1, PATIENCE_S)
    (info,) = link.node.get_publishers_info_by_topic("/probe")  # what the middleware says of the type
    recorder.close()
    (mcap,) = (tmp_path / "bag").glob("*.mcap")
    assert hashes_in(mcap.read_bytes()) == {str(info.topic_type_hash)}
    assert str(info.topic_type_hash) in (tmp_path / "bag" / "metadata.yaml").read_text()


def hashes_in(data: bytes) -> set[str]:
    """The values of the key topic_type_hash in an mcap file: a length of four bytes before each text."""
    key, found, at = b"topic_type_hash", set(), 0
    while (at := data.find(key, at)) >= 0:
        at += len(key)
        (length,) = struct.unpack_from("<I", data, at)
        found.add(data[at + 4 : at + 4 + length].decode())
    return found


def test_stamps_that_go_back_are_told_once_and_counted_in_the_bag(link, others, tmp_path, capfd):
    names = ("/probe/one", "/probe/two")
    publishers = [others.node.create_publisher(JointState, name, LOSSLESS) for name in names]
    recorder = Recorder(link.node, tmp_path / "bag", [Topic(name, "sensor_msgs/msg/JointState") for name in names])
    assert not recorder.wait_for_publishers(names, PATIENCE_S)
    for count, stamp_s in enumerate([10, 11, 12, 10, 11, 12], 1):
        for publisher in publishers:
            message = JointState()
            message.header.stamp = to_stamp(stamp_s * 1_000_000_000)
            publisher.publish(message)
        assert all(recorder.wait_for_count(name, count, PATIENCE_S) for name in names)
    assert recorder.beginnings == 2
    recorder.close()
    assert read_provenance(tmp_path / "bag")["beginnings"] == 2
    assert capfd.readouterr().err.count("stamps went back by 2.000 s") == 1


def test_a_late_message_is_no_time_jump():
    jumps = TimeJumpDetector()
    assert [jumps.observe("/x", ns) for ns in (1_000_000_000, 900_000_000, 1_100_000_000)] == [None] * 3
    assert jumps.count == 0


def test_record_command_takes_the_topics_that_it_is_given_or_all(others, tmp_path, capsys):
    assert main(["record", str(tmp_path / "bag"), "--all", "--topics", "/tf"]) == 2
    assert "contradict" in capsys.readouterr().err and not (tmp_path / "bag").exists()
    kept = others.node.create_publisher(String, "/humans/bodies/b0001/urdf", LATCHED)
    kept.publish(String(data="<robot/>"))
    others.node.create_publisher(String, "/noise", LATCHED).publish(String(data="noise"))
    assert main(["record", str(tmp_path / "bag"), "--topics", "/humans", "--seconds", "1.5"]) == 0
    assert bag_topics(tmp_path / "bag") == {"/humans/bodies/b0001/urdf": "std_msgs/msg/String"}
    (message,) = read_messages(tmp_path / "bag")
    assert message.data == serialize_message(String(data="<robot/>"))
