"""Aravis's own simulated GigE Vision camera as a process; run as: fake_gige_camera.py ADDRESS. Ends with its parent."""

import ctypes
import signal
import sys
import threading

import gi

gi.require_version("Aravis", "0.8")
from gi.repository import Aravis  # noqa: E402

PR_SET_PDEATHSIG = 1

ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
camera = Aravis.GvFakeCamera.new(sys.argv[1], "SAGOMA-TEST")
print("running" if camera.is_running() else "failed", flush=True)
threading.Event().wait()
