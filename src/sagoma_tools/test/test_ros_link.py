"""The link of a tool to a graph: its end, its memory, its middleware."""

import gc
import os
import subprocess
import sys
import threading
import tracemalloc

import pytest
from std_msgs.msg import Int64

from capture_rig.errors import InputError
from sagoma_ros.middleware import PROFILE_VARIABLE, QOS_FROM_PROFILE, profile_file, use_peers
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


# --- the middleware's settings for several machines

LOAD = "from sagoma_tools.graph.ros_link import RosLink\nwith RosLink('loader'): print('loaded')"


def test_peers_are_asked_by_unicast_with_our_profile():
    environment = {}
    use_peers("192.168.1.7, 192.168.1.8", environment)
    assert environment == {
        "ROS_STATIC_PEERS": "192.168.1.7;192.168.1.8",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        PROFILE_VARIABLE: str(profile_file()),
        QOS_FROM_PROFILE: "1",
    }
    chosen = {PROFILE_VARIABLE: "mine.xml"}
    use_peers("192.168.1.7", chosen)
    assert chosen[PROFILE_VARIABLE] == "mine.xml"  # stays


@pytest.mark.parametrize("text", ["", "server.local", "192.168.1.7;192.168.1.8", "192.168.1.300", "192.168.1.7,"])
def test_what_is_no_address_is_refused(text):
    environment = {}
    with pytest.raises(InputError, match="is no IPv4 address") as refused:
        use_peers(text, environment)
    assert "--peers" in str(refused.value) and environment == {}


@pytest.mark.parametrize("spoilt", [False, True])
def test_the_middleware_reads_the_profile_without_a_word_and_complains_of_a_spoilt_one(tmp_path, spoilt):
    profile = tmp_path / "profile.xml"
    text = profile_file().read_text()
    profile.write_text(text.replace("leaseDuration>", "leaseDurations>") if spoilt else text)
    environment = {**os.environ, PROFILE_VARIABLE: str(profile)}
    done = subprocess.run([sys.executable, "-c", LOAD], capture_output=True, text=True, env=environment, check=True)
    assert "loaded" in done.stdout
    assert ("XMLPARSER" in done.stdout + done.stderr) == spoilt


def test_link_hands_a_callbacks_exception_to_its_owner_at_close_which_ends_its_thread():
    link = RosLink("unlucky")
    raised = threading.Event()

    def fail():
        raised.set()
        raise OSError("no space left on device")

    link.node.create_timer(0.01, fail)
    assert raised.wait(10)
    with pytest.raises(OSError, match="no space left"):
        link.close()
    link.close()  # once more is no error
    assert "unlucky spin" not in {thread.name for thread in threading.enumerate()}
