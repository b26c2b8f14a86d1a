"""Tools with --namespace see the graph below it, named as without one, and no other graph."""

import threading

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger

from capture_rig.errors import InputError
from sagoma_tools.cli import main
from sagoma_tools.commands.background import select_clients
from sagoma_tools.graph.background_training import SERVICE, find_clients
from sagoma_tools.graph.diagnostics_table import DiagnosticsTable
from sagoma_tools.graph.ros_link import RosLink, in_graph, our_nodes, topics_of
from sagoma_tools.recording.reader import bag_topics, read_messages
from sagoma_tools.view.graph_panel import Feed, LiveGraph

PATIENCE_S = 30.0
KEPT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def graphs():
    """Two graphs in one domain, of one camera client each, and what each says on /icp/body."""
    with (
        RosLink("camera_client", namespace="/studio/cam01") as ours,
        RosLink("camera_client", namespace="/cam01") as root,
    ):
        for link, name in ((ours, "/studio"), (root, "")):
            link.node.create_service(Trigger, f"~/{SERVICE}", lambda request, response: response)
            publisher = link.node.create_publisher(String, f"{name}/icp/body", KEPT)
            publisher.publish(String(data=f"of {name or 'the root'}"))
            link.node.create_publisher(String, f"{name}/cam01/silhouette/compressed", KEPT)
        yield


def until(met):
    """Wait for discovery, which rclpy tells nobody of."""
    deadline, ended = PATIENCE_S / 0.05, threading.Event()
    while not met():
        deadline -= 1
        assert deadline > 0
        ended.wait(0.05)


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
    with RosLink("tool") as tool:  # without one, as ever: the nodes of all
        until(lambda: len(our_nodes(tool.node)) == 2)


def test_the_recorder_names_topics_as_they_are_without_a_namespace(graphs, tmp_path):
    bag = tmp_path / "bag"
    assert main(["record", str(bag), "--namespace", "studio", "--topics", "/icp", "--seconds", "1.5"]) == 0
    assert bag_topics(bag) == {"/icp/body": "std_msgs/msg/String"}
    (message,) = read_messages(bag)
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
        assert [each.topic_name for each in link.node.subscriptions if each.topic_name.endswith("body")] == [
            "/studio/icp/body"
        ] * 2


def test_a_namespace_that_is_none_is_refused_before_anything_starts(tmp_path, capsys):
    assert main(["record", str(tmp_path / "bag"), "--namespace", "my studio"]) == 2
    assert "--namespace" in capsys.readouterr().err and not (tmp_path / "bag").exists()
