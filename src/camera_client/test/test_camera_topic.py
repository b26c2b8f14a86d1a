"""Images of a ROS driver as a source: what it publishes is tracked as if the camera were ours."""

import contextlib
import re
import threading
import time
from itertools import count

import numpy as np
import pytest
from camera_pictures import frames_of, iou
from camera_probe import NAMESPACE
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from camera_client.frame_source import SourceUnavailable
from camera_client.settings import TopicSettings
from camera_client.sources.topic_source_ros import TopicSource
from capture_rig.errors import InputError
from sagoma_ros.images import camera_info_message, decode_silhouette, image_message, preview_message
from sagoma_ros.messages import to_stamp

TOPIC, INFO_TOPIC = (f"/driver{NAMESPACE}/{name}" for name in ("image_raw", "camera_info"))
PERIOD_S = 0.02


@pytest.fixture
def impatient(monkeypatch):
    """Who waits for a driver gives up, and tries again, after a moment."""
    monkeypatch.setattr("camera_client.sources.topic_source_ros.LASTING_S", 0.5)
    monkeypatch.setattr("camera_client.sources.supervised_source.RETRY_S", 0.1)


class Driver:
    """A foreign driver: publishes pictures in turn, stamped by the system clock, until it is closed."""

    def __init__(self, context, kind=Image, info=None, clock_ns=None):
        self.node = Node("usb_cam", context=context, use_global_arguments=False)
        self.images = self.node.create_publisher(kind, TOPIC, qos_profile_sensor_data)
        self.infos = info and self.node.create_publisher(CameraInfo, INFO_TOPIC, 10)
        self.info, self.messages, self.stamps_ns, self.clock_ns = info, [], [], clock_ns
        self.node.create_timer(PERIOD_S, self.publish)
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self.spin, daemon=True)

    def spin(self):
        with contextlib.suppress(ExternalShutdownException):
            self.executor.spin()

    def publish(self):
        message = self.messages[len(self.stamps_ns) % len(self.messages)]
        stamp_ns = next(self.clock_ns) if self.clock_ns else time.time_ns()
        message.header.stamp = to_stamp(stamp_ns)
        self.stamps_ns.append(stamp_ns)
        self.images.publish(message)
        if self.infos:
            self.info.header.stamp = message.header.stamp
            self.infos.publish(self.info)

    def start(self, messages):
        self.messages = messages
        self.thread.start()
        return self

    def close(self):
        self.executor.shutdown()
        if self.thread.is_alive():
            self.thread.join(5)
        self.node.destroy_node()


@pytest.fixture
def driver(ros_context):
    made = []

    def make(**options):
        made.append(Driver(ros_context, **options))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.fixture
def source(ros_context):
    made = []

    def make(channels="auto", **settings):
        settings = TopicSettings(**{"name": TOPIC, **settings})
        made.append(TopicSource(settings, channels, NAMESPACE, ros_context))
        return made[-1]

    yield make
    for one in made:
        one.close()


def pictures(scene, count=5):
    return [image_message(image, 0, "usb_cam") for image in scene.empty(count)]


def started(topic):
    topic.connect()
    topic.start()
    return topic


def test_driver_is_awaited_and_then_a_camera_of_the_graph_with_its_own_lens(bench, session, scene, driver, impatient):
    topic = {"source": "topic", "topic.name": TOPIC, "topic.camera_info": INFO_TOPIC, "topic.stamp_offset_ms": -7.5}
    camera = bench(**{**session.parameters, **topic}).start()
    camera.until_said("nobody publishes it")
    assert int(camera.values()["failed_attempts"]) >= 1
    info = camera_info_message(scene.camera(), 0, "usb_cam")
    info.k[0] = info.p[0] = 140.0
    people = [image_message(scene.with_person(image), 0, "usb_cam") for image in scene.empty(5, seed=4)]
    driver(info=info).start(people)
    camera.until(lambda: len(camera.masks) >= 5)
    assert camera.node.processor.camera.K[0, 0] == 140.0
    canvas = scene.camera().undistorted_view().camera
    mask = decode_silhouette(camera.masks[-1], canvas.width, canvas.height, "test")
    assert iou(mask[: scene.height, : scene.width], session.truth) > 0.9
    camera.until(lambda: camera.diagnostics and "stamp_source" in camera.values())
    values = camera.values()
    assert values["stamp_source"] == "header of the topic" and float(values["frame_rate"]) > 5


def test_stamps_are_the_drivers_moved_to_the_middle_of_the_exposure(source, scene, driver):
    usb = driver().start(pictures(scene))
    frames = frames_of(started(source(stamp_offset_ms=-7.5, stamp_uncertainty_ms=3.0)), 4)
    assert {frame.stamp_ns + 7_500_000 for frame in frames} <= set(usb.stamps_ns)
    assert {frame.uncertainty_ns for frame in frames} == {3_000_000}
    assert np.diff([frame.stamp_ns for frame in frames]).min() > 0


def test_a_damaged_image_costs_this_image_alone(source, scene, driver):
    broken = image_message(scene.empty(1)[0], 0, "usb_cam")
    broken.step += 1
    usb = driver().start(pictures(scene))
    topic = started(source())
    usb.messages = [*pictures(scene), broken]
    while not topic.counters.get("damaged"):
        topic.read(1.0)
    assert frames_of(topic, 1)[0].image.shape == topic.shape


@pytest.mark.parametrize("kind", [Image, CompressedImage])
@pytest.mark.parametrize("channels, ndim", [("mono", 2), ("colour", 3)])
def test_both_types_come_in_the_channels_that_are_asked_for(source, scene, driver, kind, channels, ndim):
    image = scene.empty(1)[0]
    message = image_message(image, 0, "c") if kind is Image else preview_message(image, 0, "c")
    driver(kind=kind).start([message])
    topic = started(source(channels))
    assert topic.shape == (scene.height, scene.width, 3)[:ndim]
    seen = frames_of(topic, 1)[0].image
    assert np.abs(seen.reshape(scene.height, scene.width, -1).mean(axis=2) - image).mean() < 3


@pytest.mark.parametrize(
    "name, said",
    [
        ("", r"topic\.name: is empty"),
        ("image_raw", f"{NAMESPACE}/image_raw is in the namespace.*__ns:=/driver{NAMESPACE}"),
    ],
    ids=["no name", "another namespace"],
)
def test_topic_that_cannot_be_the_drivers_is_refused_with_the_remedy(source, name, said):
    with pytest.raises(InputError, match=said):
        source(name=name).connect()


def test_topic_of_another_type_is_refused(source, driver):
    driver(kind=CameraInfo).start([CameraInfo()])
    with pytest.raises(InputError, match="carries sensor_msgs/msg/CameraInfo"):
        source().connect()


def test_driver_that_sends_nothing_is_unavailable(source, driver, impatient):
    driver()
    with pytest.raises(SourceUnavailable, match=f"nothing came on {TOPIC}"):
        source().connect()


def test_stamps_by_another_clock_are_a_warning(source, scene, driver):
    driver(clock_ns=count(time.time_ns() - 90 * 10**9, round(PERIOD_S * 1e9))).start(pictures(scene))
    topic = source()
    topic.connect()
    (seconds,) = re.findall("differ by ([0-9]+) s", topic.warnings[0])
    assert int(seconds) >= 90  # on a busy machine images wait
