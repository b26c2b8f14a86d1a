"""Run by namespaces.py's `inside`: what happens on several hosts, told by lines on standard output.

hosts_scenarios.py SCENARIO FOLDER [WORD ...] ; the scenarios are the functions below.
"""

import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

from doctor_fake_nodes import RIG
from namespaces import Condition, World

from capture_rig import save_rig
from sagoma_ros.middleware import PROFILE_VARIABLE, profile_file
from stick_figure.body import Body
from virtual_studio.recording.session import write_session
from virtual_studio.rig import ring

ROOT = Path(__file__).resolve().parents[2]
SERVER, CAMERAS = "server", ("cam01", "cam02", "cam03")
DOMAIN = "3"
PATIENCE_S = 300.0
SAGOMA = (sys.executable, "-m", "sagoma_tools.cli")


def environment_in(folder):
    return {"ROS_DOMAIN_ID": DOMAIN, "ROS_LOG_DIR": str(folder), PROFILE_VARIABLE: str(profile_file())}


# --- a graph of two camera hosts, a fault of the network, and what the doctor says

HOSTS, AWAY = CAMERAS[:2], "cam02"
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


# --- footage of three cameras on three hosts, the last one started later

FPS, CLIP_S = 2.0, 15.0  # so few frames a second that a busy machine plays them
BEGIN_S, WHOLE_SETS = 5.0, 10


def footage(folder):
    """Two lines of JSON: what `sagoma up --only cam01` says without a common beginning; and of the server's frame sets,
    which cameras those before the first whole one lack, and the spread of the stamps of the first whole ones."""
    session = write_session(folder / "session", ring(3, False), Body.from_stature(1.75), "walk", FPS, CLIP_S)
    environment = environment_in(folder)
    with World([SERVER, *CAMERAS]) as world:

        def up(host, *options, **pipes):
            words = ["up", str(session), "--only", host, "--loop", "--run-folder", str(folder / host), *options]
            return world.hosts[host].start([*SAGOMA, *words], environment, **pipes)

        alone = up("cam01", stderr=subprocess.PIPE, text=True)
        print(json.dumps({"says": alone.communicate()[1], "status": alone.returncode}), flush=True)
        values = {"epoch_ns": time.time_ns() + round(BEGIN_S * 1e9), "keep_up": "true", "wait_for_cameras": "false"}
        settings = [f"cameras.footage.{key}={value}" for key, value in values.items()]

        def play(host):
            log = (folder / f"{host}.log").open("w")
            up(host, *(word for text in settings for word in ("--set", text)), stdout=log, stderr=log)

        command = [sys.executable, str(ROOT / "tests/support/hosts_listener.py"), *CAMERAS]
        told = world.hosts[SERVER].start(command, environment, stdout=subprocess.PIPE)
        patience = threading.Timer(PATIENCE_S, told.kill)
        patience.start()
        for host in (SERVER, *CAMERAS[:2]):
            play(host)
        early: list[list[str]] = []
        spread_ms: list[float] = []
        for each in filter(lambda each: "missing" in each, map(json.loads, told.stdout)):
            if not each["missing"]:
                spread_ms.append(each["spread_ms"])
            elif not spread_ms:
                if each["missing"] == ["cam03"] and ["cam03"] not in early:  # the first hosts play: now the last one
                    play("cam03")
                early.append(each["missing"])
            if len(spread_ms) == WHOLE_SETS:
                break
        patience.cancel()
        print(json.dumps({"early": early, "spread_ms": spread_ms}), flush=True)


if __name__ == "__main__":
    scenario, folder, *words = sys.argv[1:]
    {"faults": faults, "footage": footage}[scenario](Path(folder), *words)
