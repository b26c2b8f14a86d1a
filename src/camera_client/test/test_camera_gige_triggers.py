"""Trigger schedules: whole multiples of a period, from many computers, without a coordinator."""

import socket
import threading
import time
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camera_client.gige.triggers import ACTION_COUNTERS, ACTION_GROUP, ActionSender, TriggerSchedule, TriggerThread
from gige_vision.gvcp import PORT, AcknowledgePacket, Action, CommandPacket, Status
from virtual_studio.gige import free_address

MS, SECOND = 1_000_000, 1_000_000_000
NOW_NS = 1_795_247_381_146_041_260
PATIENCE_S = 10


def due_over(schedule, start_ns, end_ns, step_ns):
    instants = []
    for now_ns in range(start_ns, end_ns, step_ns):
        instants += schedule.due(now_ns)
    return instants


@settings(deadline=None, max_examples=30)
@given(rate=st.sampled_from([1.0, 24.0, 29.97, 50.0, 60.0, 90.0, 100.0, 144.0]), start_ns=st.integers(0, 2**61))
def test_instants_are_whole_multiples_of_the_period_to_the_nanosecond(rate, start_ns):
    instants = due_over(TriggerSchedule(rate), start_ns, start_ns + 3 * SECOND, 3 * MS)
    exact = Fraction(rate).limit_denominator(10**6)
    assert len(instants) >= int(3 * rate) - 1
    for instant_ns in instants:
        periods = instant_ns * exact / SECOND
        assert -(exact / SECOND) < periods - round(periods) <= 0 or periods.denominator == 1  # cut to the nanosecond


def test_instants_that_passed_while_nobody_asked_are_skipped_and_counted():
    schedule = TriggerSchedule(100.0)
    before = due_over(schedule, NOW_NS, NOW_NS + 100 * MS, MS)
    after = due_over(schedule, NOW_NS + 500 * MS, NOW_NS + 600 * MS, MS)
    assert after[0] - before[-1] == (schedule.missed + 1) * 10 * MS
    assert schedule.missed in (39, 40, 41)
    assert all(instant_ns > NOW_NS + 495 * MS for instant_ns in after)


def test_clock_that_is_set_back_does_not_stop_the_triggers():
    schedule = TriggerSchedule(100.0)
    due_over(schedule, NOW_NS, NOW_NS + 100 * MS, MS)
    again = due_over(schedule, NOW_NS - 60 * SECOND, NOW_NS - 59 * SECOND, MS)
    assert len(again) == pytest.approx(100, abs=1)


def test_wait_leads_to_the_next_instant_which_is_given_once_and_ahead_of_time():
    schedule = TriggerSchedule(100.0, lead_ns=3 * MS)
    now_ns = NOW_NS
    for _ in range(20):
        now_ns += schedule.wait_ns(now_ns)
        assert [instant_ns - now_ns for instant_ns in schedule.due(now_ns)] == [3 * MS]
    assert schedule.missed == 0


def test_thread_fires_instants_when_they_are_due_and_stops():
    fired, enough = [], threading.Event()

    def fire(instant_ns):
        fired.append((instant_ns, time.time_ns()))
        if len(fired) == 20:
            enough.set()

    thread = TriggerThread(TriggerSchedule(250.0), time.time_ns, fire)
    assert enough.wait(PATIENCE_S)
    thread.stop()
    count = len(fired)
    assert all(instant_ns % (4 * MS) == 0 and instant_ns <= fired_ns for instant_ns, fired_ns in fired)
    assert len({instant_ns for instant_ns, _ in fired}) == count
    assert "trigger" not in {other.name for other in threading.enumerate()}


@pytest.fixture
def device():
    """A socket where a camera would listen, and a sender that talks to it."""
    address = free_address()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind((address, PORT))
        listener.settimeout(PATIENCE_S)
        counts = dict.fromkeys(ACTION_COUNTERS, 0)
        sender = ActionSender(address, "127.0.0.1", 7, counts)
        yield listener, sender, counts
        sender.close()


def answer(listener, status):
    packet, peer = listener.recvfrom(2048)
    command = CommandPacket.decode(packet)
    listener.sendto(AcknowledgePacket(0x101, b"", command.request_id, status).encode(), peer)
    return Action.decode(command), peer


def test_action_carries_keys_and_time_and_its_answer_is_counted(device):
    listener, sender, counts = device
    for status in (Status.SUCCESS, Status.ACTION_LATE, Status.OVERFLOW, Status.NO_REFERENCE_TIME):
        sender.send(NOW_NS)
        action, peer = answer(listener, status)
        assert action == Action(7, ACTION_GROUP, ACTION_GROUP, NOW_NS)
    listener.sendto(b"nonsense", peer)
    sender.collect()
    assert counts == {"actions": 1, "actions_late": 1, "actions_refused": 2, "actions_unanswered": 0}


@pytest.mark.parametrize("gone", [False, True], ids=["silent", "gone"])
def test_camera_that_does_not_answer_is_counted_and_holds_nobody_up(device, gone):
    listener, sender, counts = device
    if gone:
        listener.close()
    for _ in range(70):
        sender.send(NOW_NS)
    assert counts["actions_unanswered"] == 70 and counts["actions"] == 0
