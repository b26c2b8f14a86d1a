"""Run by namespaces.py's `inside`, hosts_scenarios.py FOLDER FAULT ...: a graph of two camera hosts, faults of the
network one after the other, and what the doctor says, told by lines on standard output."""

import os
import subprocess
import sys
from pathlib import Path

from doctor_fake_nodes import RIG
from namespaces import Condition, World

from capture_rig import save_rig
from sagoma_ros.middleware import PROFILE_VARIABLE, profile_file

ROOT = Path(__file__).resolve().parents[2]
SERVER, DOMAIN = "server", "3"
SAGOMA = (sys.executable, "-m", "sagoma_tools.cli")


def environment_in(folder):
    return {"ROS_DOMAIN_ID": DOMAIN, "ROS_LOG_DIR": str(folder), PROFILE_VARIABLE: str(profile_file())}


HOSTS, AWAY = ("cam01", "cam02"), "cam02"
NODES = str(ROOT / "src/sagoma_tools/test/doctor_fake_nodes.py")
SECONDS, LIFE_S = "4", "600"
ANSWERS = """
import threading
from sagoma_tools.doctor.hosts import serve
serve(threading.Event(), ready=lambda: print("ready", flush=True))
"""
NOTHING_BUT_OUR_PROBES = (
    "ip rule add pref 100 lookup local",
    "ip rule del pref 0",
    "ip rule add pref 10 iif eth0 ipproto udp dport 7400-9000 blackhole",
)  # a firewall where there is no netfilter
NO_FIREWALL = ("ip rule del pref 10", "ip rule add pref 0 lookup local", "ip rule del pref 100")


def faults(folder, *names):
    """Of each fault a line: its name, a tab, and what `sagoma doctor --json` prints."""
    environment = environment_in(folder)
    os.environ.update(environment)
    save_rig(RIG, folder / "rig.yaml")
    with World([SERVER, *HOSTS]) as world:
        for camera in HOSTS:
            start(world, camera, environment)
        for fault in names:
            print(fault, with_fault(fault, world, environment, str(folder / "rig.yaml")), sep="\t", flush=True)


def start(world, camera, environment):
    """Start a camera's nodes, and what answers the doctor."""
    host = world.hosts[camera]
    for command in ([NODES, LIFE_S, camera, "--ros-args"], ["-c", ANSWERS]):
        process = host.start([sys.executable, *command], environment, stdout=subprocess.PIPE, text=True)
        assert process.stdout.readline() == "ready\n"


def restart(world, environment):
    world.hosts[AWAY].kill()
    start(world, AWAY, environment)


def examine(world, environment, rig):
    """What the doctor on the server finds, of the graph and of the way to the camera that has the fault."""
    words = ["doctor", "--no-machine", "--json", "--live", "--seconds", SECONDS]
    words += ["--rig", rig, "--host", world.hosts[AWAY].address]
    doctor = world.hosts[SERVER].start([*SAGOMA, *words], environment, stdout=subprocess.PIPE, text=True)
    return doctor.communicate()[0].splitlines()[-1]


def with_fault(fault, world, environment, rig):
    """Bring the fault about, examine, and take it away again."""
    cable = world.cables[AWAY]
    if fault == "loss":
        cable.set(Condition(loss=0.1))
    elif fault == "MTU":
        world.cables[SERVER].set_host_mtu(9000)
    elif fault == "no multicast":
        world.pass_multicast(False)
        restart(world, environment)
    elif fault == "firewall":
        on_host(world, NOTHING_BUT_OUR_PROBES)
        restart(world, environment)
    found = examine(world, environment, rig)
    cable.set(Condition())
    world.pass_multicast(True)
    if fault == "firewall":
        on_host(world, NO_FIREWALL)
    world.cables[SERVER].set_host_mtu(None)
    world.hosts[SERVER].kill()
    if fault in ("no multicast", "firewall"):
        restart(world, environment)
    return found


def on_host(world, commands):
    """Run commands on the host that has the fault."""
    for command in commands:
        subprocess.run(world.hosts[AWAY].enter(command.split()), check=True)


if __name__ == "__main__":
    faults(Path(sys.argv[1]), *sys.argv[2:])
