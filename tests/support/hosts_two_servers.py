"""Run by namespaces.py's `inside`: a server on a machine, and a second `sagoma up --only server` on another one.

hosts_two_servers.py FOLDER ; a line of JSON: what the second one says and its status, and the log of the first one's
nodes since then.
"""

import json
import subprocess
import sys
from pathlib import Path

from namespaces import World

from capture_rig import save_rig
from virtual_studio.rig import ring

UP = [sys.executable, "-m", "sagoma_tools.cli", "up", "--rig"]
ASK = """
import time
from sagoma_tools.graph.lifecycle_client import LifecycleClient
from sagoma_tools.graph.ros_link import RosLink
names, states = ("/hull_server", "/icp_tracker", "/ekf_tracker"), {}
deadline_s = time.monotonic() + 300.0
with RosLink("asker") as link:
    while set(states.values()) != {"active"} and time.monotonic() < deadline_s:
        states = LifecycleClient(link.node).states(names)
        time.sleep(0.2)
print(",".join(map(str, states.values())))
"""  # waits until the server's nodes are active, and changes nothing


def main(folder):
    folder = Path(folder)
    save_rig(ring(3, False), folder / "rig.yaml")
    environment = {"ROS_DOMAIN_ID": "3", "ROS_LOG_DIR": str(folder)}
    with World(["first", "second"], multicast=False) as world:

        def up(host, **pipes):
            peer = world.hosts["second" if host == "first" else "first"].address
            words = ["--only", "server", "--run-folder", str(folder / host), "--peers", peer]
            return world.hosts[host].start([*UP, str(folder / "rig.yaml"), *words], environment, **pipes)

        with (folder / "first.log").open("w") as log:
            up("first", stdout=log, stderr=log)

        def states():
            command = [sys.executable, "-c", ASK]
            asker = world.hosts["first"].start(command, environment, stdout=subprocess.PIPE, text=True)
            return asker.communicate()[0].strip()

        states()
        log = next((folder / "first").glob("*.log"))
        before = len(log.read_text())
        second = up("second", stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        says = second.communicate()[1]
        told = {"says": says, "status": second.returncode, "log": log.read_text()[before:], "states": states()}
        print(json.dumps(told), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
