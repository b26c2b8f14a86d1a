"""Two machines with a cable between them, in network namespaces: what gets there, who is heard."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("doctor_two_hosts.py")
OTHER = "10.77.0.2"
PATIENCE_S = 120.0


def allowed():
    if not all(shutil.which(tool) for tool in ("unshare", "nsenter", "ip")):
        return False
    attempt = [
        "unshare",
        "-Urnm",
        "sh",
        "-c",
        "mount -t tmpfs tmpfs /dev/shm && ip link add here type veth peer name there",
    ]
    return subprocess.run(attempt, capture_output=True, check=False).returncode == 0


pytestmark = [pytest.mark.slow, pytest.mark.skipif(not allowed(), reason="no network namespaces for this user here")]


def findings_between(mtu_here, mtu_there):
    command = ["unshare", "-Urnm", sys.executable, str(SCRIPT), str(mtu_here), str(mtu_there), "cam01", "cam02,large"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])["findings"]


def found(findings, subject, about):
    return [(f["code"], f["what"]) for f in findings if (f["subject"], f["about"]) == (subject, about)]


def test_machines_with_one_packet_size_hear_each_other():
    findings = findings_between(1500, 1500)
    code, what = found(findings, f"machine {OTHER}", "mtu")[0]
    assert code == "mtu.ok" and "1500 bytes" in what
    assert f"2 in ROS_DOMAIN_ID 1, all on {OTHER}" in found(findings, "graph", "nodes")[0][1]
    assert [code for code, _ in found(findings, "camera cam02", "silhouettes")] == ["silhouettes.ok"]
    # both have the same clock, in fact
    assert found(findings, "camera cam01", "clock")[0][0] in ("clock.ok", "clock.unknown")


def test_larger_packets_than_the_other_end_takes_are_found_by_sending_some():
    ((code, what),) = found(findings_between(9000, 1500), f"machine {OTHER}", "mtu")
    assert code == "mtu.too_large" and "9000 bytes" in what and "1500 bytes" in what


def test_larger_packets_than_we_take_leave_announcements_without_nodes():
    ((code, what),) = found(findings_between(1500, 9000), "graph", "nodes")
    assert code == "nodes.only_announced" and OTHER in what
