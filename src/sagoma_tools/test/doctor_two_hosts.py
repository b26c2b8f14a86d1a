"""Run as root of namespaces of one's own (unshare -Urnm): two machines and a cable, each with its own network, shared
memory and packet size. Cameras' clients run there, the doctor here, and its JSON is printed.

doctor_two_hosts.py MTU_HERE MTU_THERE CAMERA ... ; CAMERA as doctor_fake_nodes.py takes it
"""

import os
import subprocess
import sys
from pathlib import Path

HERE, THERE = "10.77.0.1", "10.77.0.2"
SECONDS = "3"
NODES = str(Path(__file__).with_name("doctor_fake_nodes.py"))
OTHER_MACHINE = 'mount -t tmpfs tmpfs /dev/shm; ip link set lo up; echo here; read go; exec "$@"'


def sh(command):
    subprocess.run(command.split(), check=True)


def start_other_machine(cameras):
    """Its process waits for a line before it becomes the nodes."""
    command = ["unshare", "-nm", "sh", "-c", OTHER_MACHINE, "sh", sys.executable, NODES, "60", *cameras]
    other = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert other.stdout.readline() == "here\n"
    return other


def connect(other, mtu_here, mtu_there):
    sh(f"ip link add here mtu {mtu_here} type veth peer name there mtu {mtu_there} netns {other.pid}")
    sh(f"ip addr add {HERE}/24 dev here")
    sh("ip link set here up")
    sh(f"nsenter -t {other.pid} -n ip addr add {THERE}/24 dev there")
    sh(f"nsenter -t {other.pid} -n ip link set there up")
    for enter, name in (("", "here"), (f"nsenter -t {other.pid} -n ", "there")):
        # the middleware uses what is up when it starts, and never looks again
        while "state UP" not in subprocess.check_output(f"{enter}ip link show {name}".split(), text=True):
            pass
    other.stdin.write("\n")
    other.stdin.flush()
    assert other.stdout.readline() == "ready\n"


def main(mtu_here, mtu_there, *cameras):
    os.environ.update(ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET", ROS_DOMAIN_ID="1")
    sh("mount -t tmpfs tmpfs /dev/shm")
    sh("ip link set lo up")
    other = start_other_machine(cameras)
    try:
        connect(other, mtu_here, mtu_there)
        options = ("--no-machine", "--json", "--live", "--seconds", SECONDS, "--host", THERE)
        subprocess.run([sys.executable, "-m", "sagoma_tools.cli", "doctor", *options], check=False)
    finally:
        other.kill()
        other.wait()


if __name__ == "__main__":
    main(*sys.argv[1:])
