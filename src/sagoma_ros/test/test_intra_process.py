"""Packets in memory within a process, as messages outside it; messages that nobody takes are not made."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

import numpy as np
import pytest
import rclpy
from node_probe import Spinner
from rclpy.context import Context
from std_msgs.msg import Float64MultiArray, String

from capture_rig.errors import InputError
from mocap_packets.hull import HullProducts
from sagoma_ros.intra_process import Delivery, LazyPublisher, PacketPublisher, PacketSubscription
from sagoma_ros.packets import HULL_PRODUCTS, tables_message
from sagoma_ros.qos import LATCHED, RESULT

STAMP_NS = 1_700_000_000_123_456_789
HULL = HullProducts.of_points(STAMP_NS, np.array([[0.1, 0.2, 0.3]]), 0.01)


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


def hulls(node: rclpy.node.Node, closing: ExitStack) -> PacketPublisher[HullProducts]:
    publisher = PacketPublisher(node, HULL_PRODUCTS)
    closing.callback(publisher.close)
    return publisher


def follow(node: rclpy.node.Node, closing: ExitStack) -> list[Delivery[HullProducts]]:
    taken: list[Delivery[HullProducts]] = []
    closing.callback(PacketSubscription(node, HULL_PRODUCTS, taken.append).close)
    return taken


def test_packet_reaches_a_node_of_the_same_process_at_once_as_it_is(ros: Spinner, closing: ExitStack) -> None:
    publisher = hulls(make(ros, "sender"), closing)
    taken = follow(make(ros, "taker"), closing)
    publisher.publish(HULL, "map")
    (delivery,) = taken
    assert delivery.packet is HULL and (delivery.stamp_ns, delivery.frame_id) == (STAMP_NS, "map")
    assert not publisher.is_wanted  # no message was made: nobody outside listens


def test_packet_reaches_another_process_as_a_message_without_any_loss(
    ros: Spinner, outside: Spinner, closing: ExitStack
) -> None:
    publisher = hulls(make(ros, "sender"), closing)
    taken = follow(make(outside, "taker"), closing)
    ros.until(lambda: publisher.is_wanted)
    publisher.publish(HULL, "map")
    outside.until(lambda: taken)
    (delivery,) = taken
    assert (delivery.stamp_ns, delivery.frame_id) == (STAMP_NS, "map")
    assert (delivery.packet.centerline.points_world == HULL.centerline.points_world).all()


@pytest.mark.parametrize("case", ["label", "size", "nan", "tables", "stamp"])
def test_message_that_is_no_packet_is_refused_when_it_is_read(case: str) -> None:
    message = tables_message(HULL, "map")
    if case == "label":
        message.layout.dim[1].label = "centerline: x"
    if case == "size":
        message.layout.dim[2].size += 1
    if case == "nan":
        message.data[3] = float("nan")
    if case == "tables":
        message.layout.dim = message.layout.dim[:2]
    if case == "stamp":
        message.data[0] = -1.0
    with pytest.raises(InputError) as caught:
        HULL_PRODUCTS.from_message(message, "hull/products")
    assert caught.value.remedy and (case == "stamp" or str(caught.value).startswith("hull/products: "))


def test_empty_message_is_counted_and_nobody_is_called(ros: Spinner, outside: Spinner, closing: ExitStack) -> None:
    taken = follow(make(ros, "taker"), closing)
    sender = make(outside, "sender").create_publisher(Float64MultiArray, HULL_PRODUCTS.name, RESULT)
    outside.until(sender.get_subscription_count)
    sender.publish(Float64MultiArray())
    sender.publish(tables_message(HULL, "map"))
    ros.until(lambda: taken)
    assert len(taken) == 1


def test_whoever_follows_a_publisher_that_closes_listens_to_the_wire_from_then_on(
    ros: Spinner, outside: Spinner, closing: ExitStack
) -> None:
    here = PacketPublisher(make(ros, "sender"), HULL_PRODUCTS)
    taken, there = follow(make(ros, "taker"), closing), hulls(make(outside, "sender"), closing)
    assert not there.is_wanted
    here.close()
    ros.until(lambda: there.is_wanted)
    there.publish(HULL, "map")
    ros.until(lambda: taken)
    assert taken[0].packet is not HULL
    hulls(make(ros, "other_sender"), closing)
    ros.until(lambda: not there.is_wanted)


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
