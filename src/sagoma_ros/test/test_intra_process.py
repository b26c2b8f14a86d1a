"""Packets in memory within a process, as messages outside it; messages that nobody takes are not made."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

import numpy as np
import pytest
import rclpy
from node_probe import Spinner
from rclpy.context import Context
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from mocap_packets.hull import Centerline
from sagoma_ros.intra_process import Delivery, LazyPublisher, PacketPublisher, PacketSubscription
from sagoma_ros.packets import Text, packet_cloud, read_packet
from sagoma_ros.qos import LATCHED, RESULT

LINE = Centerline.of_points(np.array([[0.1, 0.2, 0.3]]), 0.01)
STAMP_NS = 1_700_000_000_123_456_789


@pytest.fixture()
def outside(ros: Spinner) -> Iterator[Spinner]:
    """Nodes of another context, as in another process."""
    context = Context()
    rclpy.init(context=context, domain_id=ros.context.get_domain_id())
    spinner = Spinner(context)
    yield spinner
    spinner.close()
    context.try_shutdown()


def make(spinner: Spinner, name: str) -> rclpy.node.Node:
    return spinner.add(rclpy.create_node(name, context=spinner.context))


@pytest.fixture()
def closing() -> Iterator[ExitStack]:
    """What was opened in this process is followed in it until it is closed."""
    with ExitStack() as stack:
        yield stack


def lines(node: rclpy.node.Node, closing: ExitStack) -> PacketPublisher[Centerline]:
    publisher = PacketPublisher[Centerline](node, PointCloud2, "line", packet_cloud)
    closing.callback(publisher.close)
    return publisher


def follow(node: rclpy.node.Node, closing: ExitStack) -> list[Delivery[Centerline]]:
    taken: list[Delivery[Centerline]] = []
    closing.callback(PacketSubscription[Centerline](node, PointCloud2, "line", taken.append).close)
    return taken


def test_packet_reaches_a_node_of_the_same_process_at_once_as_it_is(ros: Spinner, closing: ExitStack) -> None:
    publisher = lines(make(ros, "sender"), closing)
    taken = follow(make(ros, "taker"), closing)
    publisher.publish(LINE, STAMP_NS, "map")
    assert [(d.packet, d.message, d.stamp_ns, d.frame_id) for d in taken] == [(LINE, None, STAMP_NS, "map")]
    assert not publisher.is_wanted  # no message was made: nobody outside listens


def test_packet_reaches_another_process_as_a_message(ros: Spinner, outside: Spinner, closing: ExitStack) -> None:
    publisher = lines(make(ros, "sender"), closing)
    taken = follow(make(outside, "taker"), closing)
    ros.until(lambda: publisher.is_wanted)
    publisher.publish(LINE, STAMP_NS, "map")
    outside.until(lambda: taken)
    (delivery,) = taken
    assert (delivery.packet, delivery.stamp_ns, delivery.frame_id) == (None, STAMP_NS, "map")
    received = read_packet(delivery.message, Centerline, "line")
    assert (received.points_world == LINE.as_sent().points_world).all()


def test_whoever_follows_a_publisher_that_closes_listens_to_the_wire_from_then_on(
    ros: Spinner, outside: Spinner, closing: ExitStack
) -> None:
    here = PacketPublisher[Centerline](make(ros, "sender"), PointCloud2, "line", packet_cloud)
    taken, there = follow(make(ros, "taker"), closing), lines(make(outside, "sender"), closing)
    assert not there.is_wanted
    here.close()
    ros.until(lambda: there.is_wanted)
    there.publish(LINE, STAMP_NS, "map")
    ros.until(lambda: taken)
    assert taken[0].message is not None
    lines(make(ros, "other_sender"), closing)
    ros.until(lambda: not there.is_wanted)


def test_last_packet_of_a_latched_topic_is_kept_for_later_followers(ros: Spinner, closing: ExitStack) -> None:
    sender, taker = make(ros, "sender"), make(ros, "taker")
    publisher = PacketPublisher[Text](sender, String, "body", Text.to_message, LATCHED)
    closing.callback(publisher.close)
    publisher.publish(Text("old"), 1, "")
    publisher.publish(Text("new"), 2, "")
    taken: list[Delivery[Text]] = []
    closing.callback(PacketSubscription[Text](taker, String, "body", taken.append, LATCHED).close)
    assert [delivery.packet for delivery in taken] == [Text("new")]


def test_message_that_nobody_takes_is_not_made(ros: Spinner, outside: Spinner) -> None:
    publisher = LazyPublisher(make(ros, "sender"), String, "text")
    made: list[str] = []

    def message(text: str) -> String:
        made.append(text)
        return String(data=text)

    publisher.publish(message, "unheard")
    heard: list[String] = []
    make(outside, "listener").create_subscription(String, "text", heard.append, RESULT)
    ros.until(lambda: publisher.is_wanted)
    publisher.publish(message, "heard")
    outside.until(lambda: heard)
    assert made == ["heard"] == [heard[0].data]


def test_message_of_a_latched_topic_is_made_before_anybody_listens(ros: Spinner, outside: Spinner) -> None:
    publisher = LazyPublisher(make(ros, "sender"), String, "text", LATCHED)
    publisher.publish(lambda: String(data="kept"))
    heard: list[String] = []
    make(outside, "listener").create_subscription(String, "text", heard.append, LATCHED)
    outside.until(lambda: heard)
    assert heard[0].data == "kept"
