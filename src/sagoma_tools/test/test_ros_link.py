"""The link of a tool to a graph: what hours of messages leave behind."""

import gc
import threading
import tracemalloc

import pytest
from std_msgs.msg import Int64

from sagoma_tools.graph.ros_link import RosLink

WARM, COUNTED = 1000, 1000
PATIENCE_S = 60.0


@pytest.mark.slow
def test_messages_leave_no_memory_behind():
    """A recorder hears thousands of messages a second for hours: 100 bytes of each would be gigabytes."""
    with RosLink("listener") as link:
        heard = threading.Semaphore(0)
        link.node.create_subscription(Int64, "count", lambda message: heard.release(), 10)
        publisher = link.node.create_publisher(Int64, "count", 10)

        def pass_on(messages):
            for number in range(messages):
                publisher.publish(Int64(data=number))
                assert heard.acquire(timeout=PATIENCE_S)

        tracemalloc.start()  # before the warm-up: what replaces an object that is not traced would count as growth
        try:
            pass_on(WARM)
            gc.collect()
            before, _ = tracemalloc.get_traced_memory()
            pass_on(COUNTED)
            gc.collect()
            after, _ = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    assert (after - before) / COUNTED < 50.0
