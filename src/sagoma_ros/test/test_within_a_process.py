"""Within a process: the worker thread's order, dropping and closing, and packets in memory, which are messages outside
it. Events, not sleeps, order the threads."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import numpy as np
import pytest
import rclpy
from node_probe import Spinner
from rclpy.context import Context
from std_msgs.msg import Float64MultiArray, String

from capture_rig.errors import InputError
from mocap_packets.hull import HullProducts
from sagoma_ros.inputs import Worker
from sagoma_ros.intra_process import Delivery, LazyPublisher, PacketPublisher, PacketSubscription
from sagoma_ros.packets import HULL_PRODUCTS, tables_message
from sagoma_ros.qos import RESULT

PATIENCE_S = 20.0


class GatedWorker:
    """A worker whose first item blocks until ``go`` is set, and what became of all items."""

    def __init__(self, depth: int, function: Callable[[int], None] = lambda item: None) -> None:
        self.done: list[int] = []
        self.errors: list[Exception] = []
        self.dropped = 0
        self.started, self.go = threading.Event(), threading.Event()
        self.function = function
        self.worker = Worker[int]("gated", self._work, depth, on_drop=self._drop, on_error=self.errors.append)

    def block(self) -> None:
        self.worker.put(0)
        assert self.started.wait(PATIENCE_S)

    def finish(self) -> None:
        self.go.set()
        assert self.worker.close(finish=True, timeout_s=PATIENCE_S)

    def _work(self, item: int) -> None:
        self.started.set()
        assert self.go.wait(PATIENCE_S)
        self.function(item)
        self.done.append(item)

    def _drop(self) -> None:
        self.dropped += 1


def test_full_queue_drops_the_oldest_and_counts_it_and_put_never_waits() -> None:
    gated = GatedWorker(depth=3)
    gated.block()
    for item in range(1, 1000):
        gated.worker.put(item)  # would never return if it waited: the worker stands still until `finish`
    assert gated.done == [] and gated.dropped == 996
    gated.finish()
    assert gated.done == [0, 997, 998, 999]


def test_error_is_reported_and_the_next_item_worked_on() -> None:
    def fail_on_two(item: int) -> None:
        if item == 2:
            raise ValueError("two")

    gated = GatedWorker(depth=10, function=fail_on_two)
    for item in range(5):
        gated.worker.put(item)
    gated.finish()
    assert gated.done == [0, 1, 3, 4]
    assert [str(error) for error in gated.errors] == ["two"]


def test_close_drops_and_counts_what_waits_but_ends_what_runs() -> None:
    gated = GatedWorker(depth=10)
    gated.block()
    for item in (1, 2, 3):
        gated.worker.put(item)
    assert not gated.worker.close(timeout_s=0)  # item 0 still runs
    gated.go.set()
    assert gated.worker.close(timeout_s=PATIENCE_S)
    assert gated.done == [0]
    assert gated.dropped == 3


def test_patient_put_drops_nothing_and_keeps_to_the_depth() -> None:
    gated = GatedWorker(depth=2)
    gated.block()
    most = 0

    def feed() -> None:
        nonlocal most
        for item in range(1, 30):
            gated.worker.put_blocking(item)
            most = max(most, gated.worker.waiting)

    feeder = threading.Thread(target=feed)
    feeder.start()
    gated.go.set()
    feeder.join(PATIENCE_S)
    gated.finish()
    assert gated.done == list(range(30)) and gated.dropped == 0 and most <= 2


def test_patient_put_does_not_outlast_the_worker() -> None:
    gated = GatedWorker(depth=1)
    gated.block()
    gated.worker.put(1)
    feeder = threading.Thread(target=lambda: gated.worker.put_blocking(2))
    feeder.start()
    closer = threading.Thread(target=gated.worker.close)
    closer.start()
    feeder.join(PATIENCE_S)
    assert not feeder.is_alive() and gated.dropped == 2  # 1 by closing, 2 because it came too late
    gated.go.set()
    closer.join(PATIENCE_S)
    assert gated.done == [0]


# --- packets ----------------------------------------------------------------------------------------------------------

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


@pytest.mark.parametrize(
    "spoil",
    [
        lambda message: setattr(message.layout.dim[1], "label", "centerline: x"),
        lambda message: setattr(message.layout.dim[2], "size", message.layout.dim[2].size + 1),
        lambda message: message.data.__setitem__(3, float("nan")),
        lambda message: setattr(message.layout, "dim", message.layout.dim[:2]),
        lambda message: message.data.__setitem__(0, -1.0),
    ],
    ids=["label", "size", "nan", "tables", "stamp"],
)
def test_message_that_is_no_packet_is_refused_when_it_is_read(spoil: Callable[[Float64MultiArray], None]) -> None:
    message = tables_message(HULL, "map")
    spoil(message)
    with pytest.raises(InputError) as caught:
        HULL_PRODUCTS.from_message(message, "hull/products")
    assert caught.value.remedy


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
