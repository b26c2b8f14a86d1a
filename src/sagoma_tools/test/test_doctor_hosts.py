"""What the doctor finds of another machine: the path there, and whether nodes there and here find each other."""

import socket
import threading
from dataclasses import replace

import pytest

from sagoma_tools.doctor import hosts
from sagoma_tools.doctor.hosts import FULL_BYTES, HEADERS, Peer, RosSettings, query_peer, receives_multicast, serve
from sagoma_tools.doctor.machine import Interface

HERE, THERE = "10.0.0.1", "10.0.0.2"
OURS = RosSettings(domain=7, profile="fastdds.xml")
ALONE = replace(OURS, reach="LOCALHOST")
WELL = Peer((OURS,), OURS, HERE, THERE, multicast=True, port_open=True)
LINK = Interface("enp3s0", "192.168.1.1", mtu=1500, speed_mbit=1000)


def there(**settings):
    return {"nodes": (replace(OURS, **settings),)}


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [
        (there(domain=8), "domain.differs", "ROS_DOMAIN_ID 8, this doctor in 7"),
        ({"nodes": ()}, "nodes.none_there", "no ROS node"),
        (there(reach="LOCALHOST"), "discovery.local", "there ROS_AUTOMATIC_DISCOVERY_RANGE is LOCALHOST"),
        ({"ours": ALONE}, "discovery.local", "here ROS_AUTOMATIC_DISCOVERY_RANGE is LOCALHOST"),
        (there(reach="LOCALHOST", peers=("10.0.0.9",)), "discovery.local", "10.0.0.9"),
        ({"multicast": False}, "multicast.blocked", "does not arrive"),
        ({"port_open": False}, "firewall.drops", "UDP 9150 to 9399"),
        (there(profile=""), "profile.differs", "none and fastdds.xml"),
        (there(middleware="rmw_cyclonedds_cpp"), "middleware.differs", "rmw_cyclonedds_cpp"),
        ({}, "", ""),
        (there(reach="LOCALHOST", peers=(HERE,)), "", ""),
        ({**there(reach="LOCALHOST", peers=(HERE,)), "ours": ALONE}, "", ""),
        ({"ours": replace(ALONE, peers=(THERE,))}, "", ""),
        (there(middleware="rmw_fastrtps_cpp"), "", ""),
    ],
)
def test_each_setting_that_keeps_machines_apart_is_named_with_a_remedy_and_no_other(changes, code, words):
    findings = hosts.examine_peer("machine", replace(WELL, **changes))
    troubles = [finding for finding in findings if not finding.code.endswith(".ok")]
    assert [finding.code for finding in troubles] == ([code] if code else [])
    assert all(words in finding.what and finding.remedy for finding in troubles)


def test_environment_variables_are_read_as_ros_reads_them():
    old = {"ROS_LOCALHOST_ONLY": "1", "ROS_STATIC_PEERS": "10.0.0.1;10.0.0.3", "ROS_DOMAIN_ID": "12"}
    assert RosSettings.of(old) == RosSettings(12, "LOCALHOST", ("10.0.0.1", "10.0.0.3"))
    bounded = {"FASTRTPS_DEFAULT_PROFILES_FILE": "/opt/sagoma_ros/fastdds_memory.xml"}  # of a node that was told none
    assert RosSettings.of({}) == RosSettings.of(bounded) == RosSettings()


@pytest.fixture
def far_end(monkeypatch):
    """The port of an answering machine with nodes in two domains."""
    nodes = [{"ROS_DOMAIN_ID": "7"}, {"ROS_DOMAIN_ID": "7"}, {"ROS_DOMAIN_ID": "8"}]
    monkeypatch.setattr(hosts, "_node_environments", lambda: iter(nodes))
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    stop, ready = threading.Event(), threading.Event()
    thread = threading.Thread(target=serve, args=(stop, "127.0.0.1", port, ready.set))
    thread.start()
    assert ready.wait(20.0)
    yield port
    stop.set()
    thread.join()


def test_settings_of_the_nodes_there_are_asked_for_each_once_and_multicast_is_heard(far_end):
    peer = query_peer("127.0.0.1", far_end)
    assert [node.domain for node in peer.nodes] == [7, 8]
    assert (peer.here, peer.there, peer.port_open) == ("127.0.0.1", "127.0.0.1", True)
    assert receives_multicast("127.0.0.1", "127.0.0.1", 7400 + 250 * 97, far_end)


def test_an_answer_is_never_larger_than_its_question(far_end, monkeypatch):
    monkeypatch.setattr(hosts, "settings_here", lambda: {"nodes": "x" * 9000})
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.settimeout(20.0)
        other.sendto(hosts._question(FULL_BYTES), ("127.0.0.1", far_end))
        assert len(other.recv(65536)) == FULL_BYTES - HEADERS
    assert query_peer("127.0.0.1", far_end) is None  # cut, it is no answer


def test_packets_of_others_are_ignored_and_nobody_who_answers_is_no_peer(far_end):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        for packet in (b"", b"sagoma", b"x" * 40, b"sagoma?", b"sagoma?\xff", b"sagoma?\0\1"):
            other.sendto(packet, ("127.0.0.1", far_end))
    assert query_peer("127.0.0.1", far_end) is not None
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        assert query_peer("127.0.0.1", silent.getsockname()[1]) is None


@pytest.mark.parametrize(
    "link, answers, largest, code, value",
    [
        (None, False, 0, "way.none", THERE),
        (LINK, False, 0, "answer.none", THERE),
        (LINK, True, 1500, "mtu.ok", "1500 bytes"),
        (replace(LINK, mtu=9000), True, 1500, "mtu.too_large", "1500 bytes"),
        (LINK, True, 0, "mtu.too_large", "1280 bytes"),
    ],
)
def test_path_to_another_machine_is_judged_by_what_gets_there(monkeypatch, link, answers, largest, code, value):
    monkeypatch.setattr(hosts, "reaches", lambda address, size, port=0: size <= largest)
    (finding,) = hosts.check_path(THERE, link, answers)
    assert finding.code == code and value in finding.what
    assert finding.remedy or code == "mtu.ok"
