"""The way to another machine as the doctor measures and judges it: clock, losses, bandwidth."""

import socket
import threading

import pytest

from sagoma_tools.doctor.machine.network import check_way
from sagoma_tools.doctor.machine.way_probe import Way, answer, measure_way

GOOD = Way(offset_s=2e-4, error_s=1e-4, loss=0.0, rate_mbit=940.0)
AHEAD_NS = 5_000_000


@pytest.mark.parametrize(
    ("way", "code", "words"),
    [
        (Way(2.0, 1e-4, 0.0, 940.0), "clock.off", "2.00 s ahead of"),
        (Way(-0.005, 1e-4, 0.0, 940.0), "clock.imprecise", "5.0 ms behind this machine's (+- 0.1 ms)"),
        (Way(2e-4, 1e-4, 0.05, 940.0), "packets.lost", "5.0 % of 500"),
        (Way(2e-4, 1e-4, 0.0, 94.0), "bandwidth.slow", "94 Mbit/s"),
        (Way(2e-4, 1e-4, 0.9, None), "bandwidth.unknown", "too few packets"),
        (None, "way.unmeasured", "not measured"),
    ],
)
def test_each_fault_of_the_way_is_named_with_its_size_and_a_remedy(way, code, words):
    (finding,) = [finding for finding in check_way(way) if finding.code == code]
    assert words in finding.what and finding.remedy


def test_nothing_is_wrong_with_a_good_way_nor_with_a_clock_that_is_not_known_more_closely():
    assert {finding.code for finding in check_way(GOOD)} == {"clock.ok", "packets.ok", "bandwidth.ok"}
    assert "clock.ok" in {finding.code for finding in check_way(Way(0.02, 0.02, 0.0, 940.0))}


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
    way = measure_way("127.0.0.1", far_end)
    assert abs(way.offset_s - 1e-9 * AHEAD_NS) <= way.error_s + 1e-6
    assert way.loss < 1.0


def test_nobody_who_answers_is_said():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        assert measure_way("127.0.0.1", silent.getsockname()[1]) is None


def test_packets_of_others_are_ignored(far_end):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        for packet in (b"", b"SGWY", b"x" * 40, b"SGWY" + bytes(60)):
            other.sendto(packet, ("127.0.0.1", far_end))
    assert measure_way("127.0.0.1", far_end) is not None
