"""Tools with --namespace see the graph below it, named as without one, and no other graph; a tool's link to a graph:
its end, its memory, its middleware."""

import gc
import os
import signal
import subprocess
import sys
import threading
import tracemalloc
from contextlib import contextmanager
from functools import partial

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Int64, String
from std_srvs.srv import Trigger
from tools_waiting import until

from capture_rig.errors import InputError
from ekf_tracker.ekf_node import EkfNode
from sagoma_ros.middleware import PROFILE_VARIABLE, QOS_FROM_PROFILE, profile_file, use_peers
from sagoma_tools.cli import main
from sagoma_tools.commands.background import select_clients
from sagoma_tools.doctor.graph_listener import collect_graph
from sagoma_tools.graph.background_training import SERVICE, find_clients
from sagoma_tools.graph.diagnostics_table import DiagnosticsTable
from sagoma_tools.graph.ros_link import RosLink, in_graph, node_names, our_nodes, topics_of
from sagoma_tools.recording.reader import bag_topics, read_messages
from sagoma_tools.view.graph_panel import Feed, LiveGraph

PATIENCE_S = 60.0
KEPT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def graphs():
    """Two graphs in one domain, of one camera client each, and what each says on /icp/body."""
    studio, root = RosLink("camera_client", namespace="/studio/cam01"), RosLink("camera_client", namespace="/cam01")
    with studio, root:
        for link, name in ((studio, "/studio"), (root, "")):
            link.node.create_service(Trigger, f"~/{SERVICE}", lambda request, response: response)
            publisher = link.node.create_publisher(String, f"{name}/icp/body", KEPT)
            publisher.publish(String(data=f"of {name or 'the root'}"))
            link.node.create_publisher(String, f"{name}/cam01/silhouette/compressed", KEPT)
        yield


def test_nodes_services_and_topics_are_those_of_the_namespace(graphs):
    with RosLink("tool", namespace="/studio") as tool:
        (client,) = find_clients(tool.node, 1, PATIENCE_S)
        assert client == "/studio/cam01/camera_client" and our_nodes(tool.node) == {client}
        until(lambda: {"/icp/body", "/cam01/silhouette/compressed"} <= topics_of(tool.node).keys())
        assert not any(name.startswith("/studio") for name in topics_of(tool.node))
        assert in_graph(tool.node, "/diagnostics") == "/diagnostics"
        assert select_clients([client], ["cam01"], "/studio") == [client]
        with pytest.raises(InputError, match="no client of cam02"):
            select_clients([client], ["cam02"], "/studio")
    with RosLink("tool") as tool:
        until(lambda: {"/studio/cam01/camera_client"} < {*node_names(tool.node)})
        assert find_clients(tool.node, 1, PATIENCE_S) == ["/cam01/camera_client"] == [*our_nodes(tool.node)]


def test_the_recorder_names_topics_as_they_are_without_a_namespace(graphs, tmp_path, monkeypatch):
    bag = tmp_path / "bag"
    monkeypatch.setattr("sagoma_tools.recording.recorder.ANSWER_S", 0.1)  # for parameters, which the client has not

    def end_once_it_is_recorded():
        until(lambda: any(b"of /studio" in file.read_bytes() for file in bag.glob("*.mcap")))
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=end_once_it_is_recorded).start()
    assert main(["record", str(bag), "--namespace", "studio", "--seconds", f"{PATIENCE_S}"]) == 0
    assert bag_topics(bag)["/icp/body"] == "std_msgs/msg/String"
    (message,) = read_messages(bag, "/icp/body".__eq__)
    assert message.decode(String).data == "of /studio"


def test_the_page_looks_at_the_graph_of_its_namespace(graphs):
    with RosLink("page", namespace="/studio") as link:
        live = LiveGraph(link, DiagnosticsTable(link.node))
        until(lambda: "/cam01/camera_client" in live.reports())
        assert set(live.reports()) == {"/cam01/camera_client"}
        heard, feed = threading.Event(), Feed(link.node)
        link.node.create_subscription(String, in_graph(link.node, "/icp/body"), lambda message: heard.set(), KEPT)
        assert heard.wait(PATIENCE_S)
        feed.watch([("/icp/body", "std_msgs/msg/String")])
        subscribed = [each.topic_name for each in link.node.subscriptions if each.topic_name.endswith("body")]
        assert subscribed == ["/studio/icp/body"] * 2


def test_commands_drive_and_examine_the_nodes_of_their_namespace_and_no_others(capsys):
    with running_filter("/studio") as studio_state, running_filter("") as root_state:
        with RosLink("tool") as tool:
            until(lambda: {"/studio/ekf_tracker", "/ekf_tracker"} <= {*node_names(tool.node)})
        for namespace, states in (("/studio", ["active", "unconfigured"]), ("", ["active", "active"])):
            assert main(["start", "--namespace", namespace, "--wait", "30"]) == 0
            assert capsys.readouterr().out == f"{namespace}/ekf_tracker: active\n"
            assert [studio_state(), root_state()] == states
            heard = partial(collect_graph, 0.1, namespace=namespace)
            until(lambda heard=heard: [(n.name, n.state) for n in heard().nodes] == [("/ekf_tracker", "active")])


@contextmanager
def running_filter(namespace):
    """An EKF tracker in a namespace, spun by a thread of its own; yields who tells its state."""
    context = Context()
    rclpy.init(context=context)
    node, executor = EkfNode(context=context, namespace=namespace or "/"), SingleThreadedExecutor(context=context)
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    try:
        yield lambda: node._state_machine.current_state[1]
    finally:
        executor.shutdown()
        thread.join()
        node.close()
        node.destroy_node()
        context.try_shutdown()


# --- the link

MESSAGES = 1000


@pytest.mark.slow
def test_messages_leave_no_memory_behind():
    """A recorder hears thousands of messages a second for hours: 100 bytes of each would be gigabytes."""
    with RosLink("listener") as link:
        heard = threading.Semaphore(0)
        link.node.create_subscription(Int64, "count", lambda message: heard.release(), 10)
        publisher = link.node.create_publisher(Int64, "count", 10)

        traced = []
        tracemalloc.start()  # before the warm-up: what replaces an object that is not traced would count as growth
        try:
            for _ in ("warm-up", "counted"):
                for number in range(MESSAGES):
                    publisher.publish(Int64(data=number))
                    assert heard.acquire(timeout=PATIENCE_S)
                gc.collect()
                traced.append(tracemalloc.get_traced_memory()[0])
        finally:
            tracemalloc.stop()
    assert (traced[1] - traced[0]) / MESSAGES < 50.0


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
