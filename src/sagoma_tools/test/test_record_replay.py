"""Recording and replaying over real ROS topics, with a fake EKF at the far end: what is asked for, of whatever nodes,
byte for byte, in step with who answers."""

import math
import re
from dataclasses import replace
from types import SimpleNamespace

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import String
from tools_waiting import until

from capture_rig.errors import InputError
from mocap_packets.frame_set import FrameSet
from mocap_packets.people import AnsweredSet
from sagoma_ros.messages import latency_message, to_ns
from sagoma_ros.qos import LATCHED
from sagoma_tools.graph.ros_link import RosLink
from sagoma_tools.graph.topics import LATENCY_TOPIC, LOSSLESS, camera_topics
from sagoma_tools.recording.reader import BagMessage, read_messages, read_provenance
from sagoma_tools.recording.recorder import Recorder
from sagoma_tools.recording.replayer import Answers, InputPublishers, play_lockstep, play_timed, timed_by_exposures

CAMERAS = ("cam01", "cam02")
SILHOUETTE = "sensor_msgs/msg/CompressedImage"
EPOCH_NS = 1_700_000_000_000_000_000
PERIOD_NS = 20_000_000
PATIENCE_S = 30.0


def silhouette_topic(camera):
    return f"/{camera}/silhouette/compressed"


def silhouette(camera, k):
    message = CompressedImage(format="mono8; png compressed mono8", data=f"{camera} {k}".encode())
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(EPOCH_NS + k * PERIOD_NS, 1_000_000_000)
    data = serialize_message(message)
    return BagMessage(silhouette_topic(camera), SILHOUETTE, EPOCH_NS + k * PERIOD_NS, data)


def frame_set(k):
    stamp_ns = EPOCH_NS + k * PERIOD_NS
    frames = {camera: [silhouette(camera, k)] for camera in CAMERAS}
    return FrameSet(stamp_ns, frames, dict.fromkeys(CAMERAS, stamp_ns), ())


class FakeGraph:
    """Hull, ICP and EKF in one: answers a frame set once both silhouettes have come; ``deaf_to`` sets it ignores."""

    def __init__(self, link, deaf_to=()):
        self.heard, self.answered_after, self._deaf_to = [], [], deaf_to
        self.publisher = link.node.create_publisher(DiagnosticArray, LATENCY_TOPIC, LOSSLESS)
        self._subscriptions = [
            link.node.create_subscription(CompressedImage, silhouette_topic(c), self.take, LOSSLESS) for c in CAMERAS
        ]

    def take(self, message):
        stamp = message.header.stamp
        k = round((stamp.sec * 10**9 + stamp.nanosec - EPOCH_NS) / PERIOD_NS)
        self.heard.append(k)
        if self.heard.count(k) == len(CAMERAS) and k not in self._deaf_to:
            self.answered_after.append(len(self.heard))
            self.publisher.publish(latency_message(AnsweredSet(to_ns(stamp))))


def noting(waited, stop_after=math.inf):
    """Who waits for nothing, notes for what, and is stopped after so many times."""
    return lambda due_s: waited.append(due_s) or len(waited) <= stop_after


@pytest.mark.parametrize("rate", [1.0, 0.25])
def test_timed_replay_waits_for_recorded_intervals_divided_by_the_rate_until_it_is_stopped(rate):
    log_ms = [0, 5, 5, 40, 1000]
    messages = [BagMessage("/x", SILHOUETTE, EPOCH_NS + ms * 1_000_000, b"") for ms in log_ms]
    for stop_after, played in ((5, 5), (3, 3)):
        waited, published = [], []
        publishers = SimpleNamespace(publish=published.append)
        assert play_timed(messages, publishers, noting(waited, stop_after), rate) == played
        assert waited[:played] == pytest.approx([ms / 1000 / rate for ms in log_ms[:played]])
        assert published == messages[:played]


def test_timed_replay_keeps_step_with_the_stamps_of_footage_that_was_played_as_fast_as_it_was_answered():
    """Recorded at a quarter of the stamps' speed, twice; a body's sizes between."""
    recorded = [replace(silhouette("cam01", 100 + k), log_ns=EPOCH_NS + 4 * k * PERIOD_NS) for k in range(4)]
    began_anew = [replace(silhouette("cam01", k), log_ns=EPOCH_NS + (20 + 4 * k) * PERIOD_NS) for k in range(2)]
    body = BagMessage("/icp/body", "std_msgs/msg/String", EPOCH_NS + 6 * PERIOD_NS, b"")
    messages = [*recorded[:2], body, *recorded[2:], *began_anew]
    timed = list(timed_by_exposures(messages, {recorded[0].topic}))
    assert [message.data for message in timed] == [message.data for message in messages]
    due = [round((message.log_ns - EPOCH_NS) / PERIOD_NS) for message in timed]
    assert due == [0, 1, 1, 2, 3, 11, 12]  # a beginning comes when it was recorded after what was before
    assert [m.log_ns for m in timed_by_exposures(messages, ())] == [m.log_ns for m in messages]


@pytest.mark.parametrize("rate", [1.0, 0.5])
def test_simulated_clock_shows_the_bags_time_at_the_bags_pace(rate):
    ticks, order = [], []
    messages = [BagMessage("/x", SILHOUETTE, EPOCH_NS + ms * 1_000_000, b"") for ms in (0, 35, 100)]
    waited = []

    def show(ns):
        ticks.append((waited[-1], ns))
        order.append(ns)

    publishers = SimpleNamespace(publish=lambda message: order.append(message.log_ns))
    assert play_timed(messages, publishers, noting(waited), rate, show, 50.0) == 3
    assert len(ticks) == round(100 / rate / 20)  # every 20 ms of the player's time, from the first message on
    for at_s, shown_ns in ticks:
        assert shown_ns - EPOCH_NS == pytest.approx(at_s * rate * 1e9, abs=1000)
    assert order == sorted(order)  # nothing of the bag is sent long before the clock shows its time


@pytest.fixture()
def far_link():
    with RosLink("fake_graph") as link:
        yield link


def connected_publishers(link):
    publishers = InputPublishers(link.node, {silhouette_topic(camera): SILHOUETTE for camera in CAMERAS})
    publishers.wait_for_subscribers(map(silhouette_topic, CAMERAS), timeout_s=20)
    return publishers


@pytest.mark.parametrize("deaf_to", [(), (2,)])
def test_lockstep_sends_no_set_before_the_one_before_is_answered_or_given_up(link, far_link, deaf_to):
    graph, answers = FakeGraph(far_link, deaf_to), Answers(link.node)  # subscribed before the first set is sent
    until(lambda: graph.publisher.get_subscription_count() == 1)
    timeout_s = 2.0 if deaf_to else 20.0
    report = play_lockstep(map(frame_set, range(30)), connected_publishers(link), answers, timeout_s=timeout_s)
    assert report.sets == 30
    assert report.unanswered_ns == [EPOCH_NS + k * PERIOD_NS for k in deaf_to]
    # set k was answered after exactly 2 (k + 1) silhouettes had been heard: nothing ran ahead
    assert graph.answered_after == [2 * (k + 1) for k in range(30) if k not in deaf_to]
    assert graph.heard == [k for k in range(30) for _ in CAMERAS]


def test_lockstep_is_an_error_when_the_ekf_stays_silent_from_the_start(link, far_link):
    FakeGraph(far_link, deaf_to=range(5))
    answers = Answers(link.node)
    with pytest.raises(InputError, match="/mocap/latency: no answer to the first frame set"):
        play_lockstep(map(frame_set, range(5)), connected_publishers(link), answers, timeout_s=0.5)


def test_replay_without_a_subscriber_names_the_topic(link):
    publishers = InputPublishers(link.node, {silhouette_topic("cam01"): SILHOUETTE})
    with pytest.raises(InputError, match="/cam01/silhouette/compressed: no subscriber within"):
        publishers.wait_for_subscribers([silhouette_topic("cam01")], timeout_s=0.2)


def test_replay_beside_a_live_camera_names_it_and_publishes_nothing(link, far_link):
    graph = FakeGraph(far_link)
    publishers = connected_publishers(link)
    topic, other = silhouette_topic("cam02"), silhouette_topic("cam03")
    live = [far_link.node.create_publisher(CompressedImage, name, LOSSLESS) for name in (topic, other)]
    until(lambda: len(link.node.get_publishers_info_by_topic(topic)) == 2)
    with pytest.raises(InputError, match=r"^/fake_graph: live cameras publish these silhouettes.*--only server"):
        publishers.require_no_other(map(silhouette_topic, CAMERAS))
    far_link.node.destroy_publisher(live[0])
    until(lambda: len(link.node.get_publishers_info_by_topic(topic)) == 1)
    publishers.require_no_other(map(silhouette_topic, CAMERAS))  # a camera that the bag lacks may be live
    assert graph.heard == []


def test_recorded_bytes_equal_the_published_ones(link, far_link, tmp_path):
    topics = [topic for camera in CAMERAS for topic in camera_topics(camera)]
    rig = tmp_path / "some_rig.yaml"
    rig.write_text("cameras: {}\n")
    recorder = Recorder(link.node, tmp_path / "bag", topics)
    publishers = connected_publishers(far_link)
    published = [silhouette(camera, k) for k in range(40) for camera in CAMERAS]
    for message in published:
        publishers.publish(message)
    for camera in CAMERAS:
        assert recorder.wait_for_count(silhouette_topic(camera), 40, timeout_s=20)
    counts = recorder.close({"graph": {"/hull_server": {"voxel_mm": 20.0}}}, rig)
    read = list(read_messages(tmp_path / "bag"))
    for camera in CAMERAS:
        sent = [m.data for m in published if m.topic == silhouette_topic(camera)]
        assert [m.data for m in read if m.topic == silhouette_topic(camera)] == sent
        assert counts[f"/{camera}/camera_info"] == 0
    assert (tmp_path / "bag" / "rig.yaml").read_text() == rig.read_text()
    document = read_provenance(tmp_path / "bag")
    assert document["graph"]["/hull_server"]["voxel_mm"] == 20.0 and "rosbags" in document["software"]
    metadata = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert metadata["storage_identifier"] == "mcap" and metadata["message_count"] == len(published)
    described = [topic["topic_metadata"] for topic in metadata["topics_with_message_count"]]
    (described,) = [topic for topic in described if topic["name"] == silhouette_topic("cam01")]
    announced = far_link.node.get_publishers_info_by_topic(silhouette_topic("cam01"))[0].topic_type_hash
    assert described["type_description_hash"] == str(announced)  # as ROS itself has it
    assert described["offered_qos_profiles"][0]["reliability"] == "reliable"
    assert re.fullmatch(r"\d+\.\d+\.\d+( \([0-9a-f]{12}(, modified)?\))?", document["software"]["sagoma"])


def test_cameras_and_persons_but_the_first_are_found_as_they_appear(link, far_link, tmp_path):
    bodies = [f"/mocap/bodies/b000{number}/robot_description" for number in (1, 2)]
    said = [far_link.node.create_publisher(String, body, LATCHED) for body in bodies]
    for publisher in said:
        publisher.publish(String(data="a body"))
    recorder = Recorder(link.node, tmp_path / "bag", [])
    recorder.add_new_sources()
    publishers = connected_publishers(far_link)
    publishers.publish(silhouette("cam01", 0))
    assert recorder.wait_for_count(silhouette_topic("cam01"), 1, timeout_s=20)
    assert recorder.wait_for_count(bodies[1], 1, PATIENCE_S)
    assert set(recorder.close()) == {t.name for camera in CAMERAS for t in camera_topics(camera)} | {bodies[1]}
