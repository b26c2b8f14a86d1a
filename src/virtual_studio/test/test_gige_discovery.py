"""Discovery by broadcast, in a network namespace of its own, so that nothing leaves the machine."""

import shutil
import subprocess
import sys

import pytest

SCRIPT = """
import subprocess, sys
subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
import gi
gi.require_version("Aravis", "0.8")
from gi.repository import Aravis
from virtual_studio.gige import CameraSettings, PatternScene, SimulatedCamera
settings = {f"127.0.0.{n}": CameraSettings(serial=f"S{n}", broadcast=True) for n in (2, 3)}
cameras = [SimulatedCamera(address, PatternScene(), each) for address, each in settings.items()]
for camera in cameras:
    camera.start()
Aravis.update_device_list()
print(sorted(Aravis.get_device_serial_nbr(i) for i in range(Aravis.get_n_devices())))
for camera in cameras:
    camera.close()
"""


def why_no_namespace():
    if not (shutil.which("unshare") and shutil.which("ip")):
        return "unshare or ip is not installed"
    tried = subprocess.run(["unshare", "-Urn", "true"], capture_output=True, text=True)
    return f"no network namespace can be made here ({tried.stderr.strip()})" if tried.returncode else ""


def test_broadcast_discovery_finds_every_camera_that_listens_for_it(aravis):
    if reason := why_no_namespace():
        pytest.skip(reason)
    command = ["unshare", "-Urn", sys.executable, "-c", SCRIPT]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.stdout.strip() == "['S2', 'S3']", done.stderr
