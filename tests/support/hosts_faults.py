"""Run by namespaces.py's `inside`: a graph of two camera hosts, a fault of the network, and what the doctor says.

hosts_faults.py FOLDER FAULT ... ; of each fault a line: its name, a tab, and what `sagoma doctor --json` prints.
"""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

from doctor_fake_nodes import RIG
from namespaces import Condition, World

from capture_rig import save_rig
from sagoma_ros.middleware import PROFILE_VARIABLE, profile_file

NODES = str(Path(__file__).resolve().parents[2] / "src/sagoma_tools/test/doctor_fake_nodes.py")
SERVER, HOSTS, AWAY = "server", ("cam01", "cam02"), "cam02"
DOMAIN, OTHER_DOMAIN, SECONDS = "3", "4", "4"
LEAD_S = {"clock 2 s": 2.0, "clock 40 ms": 0.04}
LIFE_S = "600"
ANSWERS = """
import threading
from sagoma_tools.doctor.hosts import serve
serve(threading.Event(), ready=lambda: print("ready", flush=True))
"""
ALONE = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
ELSEWHERE = {**ALONE, "ROS_STATIC_PEERS": "10.66.0.99"}
A_SERVER = """
import threading
from doctor_fake_nodes import FakeGraph
with FakeGraph([], ["hull_server", "icp_tracker", "ekf_tracker"]):
    threading.Event().wait()
"""
NOTHING_BUT_OUR_PROBES = (
    "ip rule add pref 100 lookup local",
    "ip rule del pref 0",
    "ip rule add pref 10 iif eth0 ipproto udp dport 7400-9000 blackhole",
)  # a firewall where there is no netfilter
NO_FIREWALL = ("ip rule del pref 10", "ip rule add pref 0 lookup local", "ip rule del pref 100")


def start(world, camera, environment, lead_s=0.0):
    """Start a camera's nodes, by a clock that is so far ahead, and what answers the doctor."""
    host = world.hosts[camera]
    for command in ([NODES, LIFE_S, f"{camera},lead={lead_s}", "--ros-args"], ["-c", ANSWERS]):
        process = host.start([sys.executable, *command], environment, stdout=subprocess.PIPE, text=True)
        assert process.stdout.readline() == "ready\n"


def restart(world, environment, **options):
    world.hosts[AWAY].kill()
    start(world, AWAY, environment, **options)


def examine(world, environment, rig):
    """What the doctor on the server finds, of the graph and of the way to the camera that has the fault."""
    words = ["doctor", "--no-machine", "--json", "--live", "--seconds", SECONDS]
    words += ["--rig", rig, "--host", world.hosts[AWAY].address]
    command = [sys.executable, "-m", "sagoma_tools.cli", *words]
    doctor = world.hosts[SERVER].start(command, environment, stdout=subprocess.PIPE, text=True)
    return doctor.communicate()[0].splitlines()[-1]


def with_fault(fault, world, environment, rig):
    """Bring the fault about, examine, and take it away again."""
    cable = world.cables[AWAY]
    elsewhere = {
        "domain": {"ROS_DOMAIN_ID": OTHER_DOMAIN},
        "localhost": ALONE,
        "missing peer": ELSEWHERE,
        "profile": {PROFILE_VARIABLE: rig.replace("rig.yaml", "other.xml")},
    }
    if fault in LEAD_S:
        restart(world, environment, lead_s=LEAD_S[fault])
    elif fault in elsewhere:
        restart(world, {**environment, **elsewhere[fault]})
    elif fault == "loss":
        cable.set(Condition(loss=0.2))
    elif fault == "MTU":
        world.cables[SERVER].set_host_mtu(9000)
    elif fault == "no multicast":
        world.pass_multicast(False)
        restart(world, environment)
    elif fault == "firewall":
        on_host(world, NOTHING_BUT_OUR_PROBES)
        restart(world, environment)
    elif fault == "two servers":
        for host in (SERVER, AWAY):
            world.hosts[host].start([sys.executable, "-c", A_SERVER], environment)
    elif fault == "vanished":
        cable.cut()
        world.hosts[AWAY].kill()
        time.sleep(4.0)  # the profile's lease of 3 s, and an announcement
    found = examine(world, environment, rig)
    cable.mend()
    cable.set(Condition())
    world.pass_multicast(True)
    if fault == "firewall":
        on_host(world, NO_FIREWALL)
    world.cables[SERVER].set_host_mtu(None)
    world.hosts[SERVER].kill()
    if fault not in ("none", "loss", "MTU"):
        restart(world, environment)
    return found


def on_host(world, commands):
    """Run commands on the host that has the fault."""
    for command in commands:
        subprocess.run(world.hosts[AWAY].enter(command.split()), check=True)


def main(folder, *faults):
    environment = {"ROS_DOMAIN_ID": DOMAIN, "ROS_LOG_DIR": folder, PROFILE_VARIABLE: str(profile_file())}
    os.environ.update(environment)
    rig = str(Path(folder) / "rig.yaml")
    save_rig(RIG, rig)
    shutil.copy(profile_file(), Path(folder) / "other.xml")
    with World([SERVER, *HOSTS]) as world:
        for camera in HOSTS:
            start(world, camera, environment)
        for fault in faults:
            print(fault, with_fault(fault, world, environment, rig), sep="\t", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
