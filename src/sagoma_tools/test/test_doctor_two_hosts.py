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


def said(findings, subject, about):
    return [(f["severity"], f["what"]) for f in findings if (f["subject"], f["about"]) == (subject, about)]


def test_machines_with_one_packet_size_hear_each_other():
    findings = findings_between(1500, 1500)
    assert said(findings, f"machine {OTHER}", "mtu")[0] == ("ok", f"packets of 1500 bytes reach {OTHER} through here")
    assert f"2 in ROS_DOMAIN_ID 1, all on {OTHER}" in said(findings, "graph", "nodes")[0][1]
    assert [severity for severity, _ in said(findings, "camera cam02", "silhouettes")] == ["ok"]
    # both have the same clock, in fact
    assert said(findings, "camera cam01", "clock")[0][0] in ("ok", "note")


def test_larger_packets_than_the_other_end_takes_are_found_by_sending_some():
    assert said(findings_between(9000, 1500), f"machine {OTHER}", "mtu") == [
        ("error", f"here sends packets of 9000 bytes, but 1500 bytes at most reach {OTHER}: larger messages vanish")
    ]


def test_larger_packets_than_we_take_leave_announcements_without_nodes():
    (nodes,) = said(findings_between(1500, 9000), "graph", "nodes")
    assert nodes[0] == "error" and f"no node is heard in ROS_DOMAIN_ID 1, though {OTHER} announces some" in nodes[1]
