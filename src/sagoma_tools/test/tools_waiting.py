"""Waiting for what tells nobody that it has come: a change of the graph, the end of a job, a line of a log."""

import threading
import time

from sagoma_tools.graph.ros_link import settled

PATIENCE_S = 60.0


def until(come):
    """Wait until it has come; fails after a minute."""
    end_s, pause = time.monotonic() + PATIENCE_S, threading.Event()
    while not come():
        assert time.monotonic() < end_s, "it never came"
        pause.wait(0.02)


def settled_at(count):
    """A stand-in for `settled`: discovery ends once there are so many, however busy the machine."""
    return lambda look, expect, wait_s: settled(look, count, PATIENCE_S)
