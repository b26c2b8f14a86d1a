"""Run by bench/namespaces.py's `inside`: a server on a machine, and a second `sagoma up --only server` on another one.

hosts_two_servers.py FOLDER ; a line of JSON: what the second one says and its status, and the log of the first one's
nodes since then.
"""

import json
import subprocess
import sys
import time
from pathlib import Path

from namespaces import World

from capture_rig import save_rig
from virtual_studio.rig import ring

ACTIVE, PATIENCE_S = "active", 300.0
SAGOMA = [sys.executable, "-m", "sagoma_tools.cli"]
NODES = ("/hull_server", "/icp_tracker", "/ekf_tracker")


def main(folder):
    folder = Path(folder)
    save_rig(ring(3, False), folder / "rig.yaml")
    environment = {"ROS_DOMAIN_ID": "3", "ROS_LOG_DIR": str(folder)}
    with World(["first", "second"], multicast=False) as world:

        def sagoma(host, *words, **pipes):
            peer = world.hosts["second" if host == "first" else "first"].address
            return world.hosts[host].start([*SAGOMA, *words, "--peers", peer], environment, **pipes)

        def up(host, **pipes):
            words = ("up", "--rig", str(folder / "rig.yaml"), "--only", "server", "--run-folder", str(folder / host))
            return sagoma(host, *words, **pipes)

        with (folder / "first.log").open("w") as log:
            up("first", stdout=log, stderr=log)
        deadline_s = time.monotonic() + PATIENCE_S
        said = ""
        while said.count(f": {ACTIVE}") < len(NODES) and time.monotonic() < deadline_s:
            said = sagoma("first", "start", "--expect", "3", stdout=subprocess.PIPE, text=True).communicate()[0]
        log = next((folder / "first").glob("*.log"))
        before = len(log.read_text())
        second = up("second", stderr=subprocess.PIPE, text=True)
        says = second.communicate()[1]
        states = sagoma("first", "start", "--expect", "3", stdout=subprocess.PIPE, text=True).communicate()[0]
        told = {"says": says, "status": second.returncode, "log": log.read_text()[before:], "states": states}
        print(json.dumps(told), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
