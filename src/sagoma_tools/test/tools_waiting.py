"""Waiting for what tells nobody that it has come: a change of the graph, the end of a job, a line of a log."""

import threading
import time

PATIENCE_S = 60.0


def until(come):
    """Wait until it has come; fails after a minute."""
    end_s, pause = time.monotonic() + PATIENCE_S, threading.Event()
    while not come():
        assert time.monotonic() < end_s, "it never came"
        pause.wait(0.02)
