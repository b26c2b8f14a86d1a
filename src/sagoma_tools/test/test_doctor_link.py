"""The link to another machine as the doctor measures and judges it: clock, losses, bandwidth."""

import socket
import threading

import pytest

from sagoma_tools.doctor.machine.link_probe import LinkFacts, answer, measure_link
from sagoma_tools.doctor.machine.network import check_link

GOOD = LinkFacts(offset_s=2e-4, error_s=1e-4, loss=0.0, rate_mbit=940.0)
AHEAD_NS = 5_000_000


@pytest.mark.parametrize(
    ("link", "code", "words"),
    [
        (LinkFacts(2.0, 1e-4, 0.0, 940.0), "clock.off", "2.00 s ahead of"),
        (LinkFacts(-0.005, 1e-4, 0.0, 940.0), "clock.imprecise", "5.0 ms behind this machine's (+- 0.1 ms)"),
        (LinkFacts(2e-4, 1e-4, 0.05, 940.0), "packets.lost", "5.0 % of 500"),
        (LinkFacts(2e-4, 1e-4, 0.0, 94.0), "bandwidth.slow", "94 Mbit/s"),
        (LinkFacts(2e-4, 1e-4, 0.9, None), "bandwidth.unknown", "too few packets"),
        (None, "way.unmeasured", "not measured"),
    ],
)
def test_each_fault_of_the_link_is_named_with_its_size_and_a_remedy(link, code, words):
    (finding,) = [finding for finding in check_link(link) if finding.code == code]
    assert words in finding.what and finding.remedy


def test_nothing_is_wrong_with_a_good_way_nor_with_a_clock_that_is_not_known_more_closely():
    assert {finding.code for finding in check_link(GOOD)} == {"clock.ok", "packets.ok", "bandwidth.ok"}
    assert "clock.ok" in {finding.code for finding in check_link(LinkFacts(0.02, 0.02, 0.0, 940.0))}


@pytest.fixture
def far_end():
    """The port of an answering machine whose clock is 5 ms ahead."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    stop, begun = threading.Event(), threading.Event()
    clock = {"address": "127.0.0.1", "port": port, "clock_ns": lambda now_ns: now_ns + AHEAD_NS, "begun": begun.set}
    thread = threading.Thread(target=answer, args=(stop,), kwargs=clock)
    thread.start()
    assert begun.wait(10.0)
    yield port
    stop.set()
    thread.join()


def test_a_clock_that_is_ahead_is_measured_to_half_the_round_trip(far_end):
    link = measure_link("127.0.0.1", far_end)
    assert abs(link.offset_s - 1e-9 * AHEAD_NS) <= link.error_s + 1e-6
    assert link.loss < 1.0


def test_nobody_who_answers_is_said():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        assert measure_link("127.0.0.1", silent.getsockname()[1]) is None


def test_packets_of_others_are_ignored(far_end):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        for packet in (b"", b"SGWY", b"x" * 40, b"SGWY" + bytes(60)):
            other.sendto(packet, ("127.0.0.1", far_end))
    assert measure_link("127.0.0.1", far_end) is not None
