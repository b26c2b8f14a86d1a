"""What the doctor says of another machine's ROS settings: whether nodes there and here find each other, and why not."""

import socket
import threading

import pytest

from sagoma_tools.doctor.machine import peer_settings
from sagoma_tools.doctor.machine.link_probe import CAR_BYTES, PACKET, answer, ask_settings
from sagoma_tools.doctor.machine.peer_settings import PeerFacts, PeerLink, RosSettings, check_peer

HERE, THERE = "10.0.0.1", "10.0.0.2"
OURS = RosSettings(domain=7, profile="fastdds.xml")
LINK = PeerLink(HERE, THERE, announces=True, port_open=True)


def there(**settings):
    node = RosSettings(**{"domain": 7, "profile": "fastdds.xml", **settings})
    return PeerFacts((node,), (node.domain,), node)


def codes(theirs, ours=OURS, link=LINK):
    return {finding.code: finding for finding in check_peer(theirs, ours, link)}


ALONE = RosSettings(domain=7, reach="LOCALHOST", profile="fastdds.xml")


@pytest.mark.parametrize(
    ("theirs", "ours", "link", "code", "words"),
    [
        (there(domain=8), OURS, LINK, "domain.differs", "ROS_DOMAIN_ID 8, this doctor in 7"),
        (PeerFacts((), (9,), RosSettings()), OURS, LINK, "domain.differs", "ROS_DOMAIN_ID 9"),
        (PeerFacts((), (), RosSettings()), OURS, LINK, "nodes.none_there", "no ROS node"),
        (there(reach="LOCALHOST"), OURS, LINK, "discovery.local", "LOCALHOST there"),
        (there(), ALONE, LINK, "discovery.local", "LOCALHOST here"),
        (there(reach="LOCALHOST", peers=("10.0.0.9",)), OURS, LINK, "peers.missing", "10.0.0.9"),
        (there(), OURS, PeerLink(HERE, THERE, False, True), "multicast.blocked", "does not arrive"),
        (there(), OURS, PeerLink(HERE, THERE, True, False), "firewall.drops", "UDP 9150 to 9399"),
        (there(profile=""), OURS, LINK, "profile.differs", "none and fastdds.xml"),
        (there(middleware="rmw_cyclonedds_cpp"), OURS, LINK, "middleware.differs", "rmw_cyclonedds_cpp"),
    ],
)
def test_each_setting_that_keeps_machines_apart_is_named_with_a_remedy(theirs, ours, link, code, words):
    finding = codes(theirs, ours, link)[code]
    assert words in finding.what and finding.remedy


@pytest.mark.parametrize(
    ("theirs", "ours"),
    [
        (there(), OURS),
        (there(reach="LOCALHOST", peers=(HERE,)), OURS),
        (there(reach="LOCALHOST", peers=(HERE,)), ALONE),
        (there(), RosSettings(domain=7, reach="LOCALHOST", peers=(THERE,), profile="fastdds.xml")),
        (there(middleware="rmw_fastrtps_cpp"), OURS),
    ],
)
def test_machines_that_find_each_other_are_well(theirs, ours):
    assert all(code.endswith(".ok") for code in codes(theirs, ours))


def test_environment_variables_are_read_as_ros_reads_them():
    old = {"ROS_LOCALHOST_ONLY": "1", "ROS_STATIC_PEERS": "10.0.0.1;10.0.0.3", "ROS_DOMAIN_ID": "12"}
    assert RosSettings.of(old) == RosSettings(12, "LOCALHOST", ("10.0.0.1", "10.0.0.3"))
    assert RosSettings.of({}) == RosSettings()


@pytest.mark.parametrize("told", [b"", b"{", b"[]", b'{"nodes":[{}],"domains":[],"shell":{}}', b"\xff" * 40])
def test_an_answer_that_is_none_is_no_settings(told):
    assert PeerFacts.from_json(told) is None


def test_settings_are_asked_for_and_never_larger_than_the_question():
    facts = PeerFacts((ALONE, OURS), (7, 8), ALONE)
    stop, begun = threading.Event(), threading.Event()
    told = [facts.to_json(), b"x" * 9000]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    answers = {"address": "127.0.0.1", "port": port, "begun": begun.set, "settings": lambda: told.pop(0)}
    thread = threading.Thread(target=answer, args=(stop,), kwargs=answers)
    thread.start()
    try:
        assert begun.wait(20.0)
        answered, own = ask_settings("127.0.0.1", port)
        assert PeerFacts.from_json(answered) == facts and own == "127.0.0.1"
        assert len(ask_settings("127.0.0.1", port)[0]) == CAR_BYTES - PACKET.size
    finally:
        stop.set()
        thread.join()


def test_nodes_of_this_network_tell_their_own_environment(monkeypatch):
    environments = [{"ROS_DOMAIN_ID": "5"}, {"ROS_DOMAIN_ID": "5"}, {"ROS_DOMAIN_ID": "6"}]
    monkeypatch.setattr(peer_settings, "_node_environments", lambda: iter(environments))
    assert [node.domain for node in peer_settings.collect_here().nodes] == [5, 6]
