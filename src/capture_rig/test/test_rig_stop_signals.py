"""Signals become an event, at whatever instruction they come, and handlers are as before afterwards."""

import os
import signal

import pytest

from capture_rig.stop_signals import STOP_SIGNALS, StopOnSignal


@pytest.mark.parametrize("number", STOP_SIGNALS)
def test_signal_sets_the_event_and_the_handler_goes_with_the_context(number):
    before = signal.getsignal(number)
    with StopOnSignal() as stop:
        assert not stop.is_set()
        os.kill(os.getpid(), number)
        assert stop.wait(30)
    assert signal.getsignal(number) == before


def test_signal_that_comes_while_the_events_lock_is_held_does_not_hang():
    with StopOnSignal() as stop:
        with stop._cond:  # as in the midst of its wait()
            os.kill(os.getpid(), signal.SIGTERM)
        assert stop.wait(30)
