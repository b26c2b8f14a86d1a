"""Hosts in network namespaces: what arrives of the cameras' silhouettes, and what the doctor says, under each fault."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from namespaces import inside, why_not

DRILL_S = 900.0
ROOT = Path(__file__).resolve().parents[1]
FAULTS = ("none", "loss", "MTU", "no multicast", "firewall")
"""Those that only a network has; each setting of nodes that keeps machines apart: test_doctor_hosts; clocks, doubles
and absent cameras: test_doctor_graph and test_doctor_live; a host that vanishes: the drill above."""
AWAY, AWAY_ADDRESS = "camera cam02", "machine 10.66.0.3"


@pytest.fixture(scope="module")
def needs_namespaces():
    if reason := why_not():
        pytest.skip(reason)


def run_drill(*options, hz=20):
    """The rows of bench/hosts.py by name."""
    command = [sys.executable, str(ROOT / "bench/hosts.py"), "--quick", "--cameras", "3", "--hz", f"{hz}", *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=DRILL_S, check=True)
    return {row["name"]: row for row in json.loads(done.stdout.splitlines()[-1])["rows"]}


@pytest.mark.slow
def test_sets_are_whole_where_silhouettes_are_sent_again_and_a_host_that_vanishes_costs_its_own_view(needs_namespaces):
    rows = run_drill("--resend")
    assert rows["plain"]["complete"] > 0.9
    # 65 % of the exposures arrive whole: 0.95 ** (3 cameras * 2 or 3 packets)
    assert rows["loss 5 %"]["complete"] > 0.8
    gone = rows["a host vanishes"]
    assert gone["complete"] == 0.0 and gone["formed"] > 0.9
    assert gone["noticed_s"] is not None and gone["recovered_s"] is not None


@pytest.mark.slow
def test_hosts_find_each_other_by_unicast_where_the_network_passes_no_multicast(needs_namespaces):
    assert run_drill("--peers", "--only", "plain")["plain"]["complete"] > 0.9


@pytest.mark.slow
def test_a_camera_pc_that_vanished_sends_masks_again_once_it_is_switched_on(needs_namespaces):
    gone = run_drill("--clients", "--only", "a host vanishes", hz=5)["a host vanishes"]
    assert gone["complete"] == 0.0 and gone["formed"] > 0.7 and gone["tracked"] > 0.5
    assert gone["noticed_s"] is not None and gone["recovered_s"] is not None
    assert "camera cam03: node.missing" in gone["found"] and "answer.none" in gone["found"]


@pytest.fixture(scope="module")
def said(needs_namespaces, tmp_path_factory):
    """Of each fault, the codes of what the doctor found, by subject; and all its words."""
    search = [ROOT / "tests/support", ROOT / "src/sagoma_tools/test"]
    path = os.pathsep.join([*map(str, search), *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [str(ROOT / "tests/support/hosts_scenarios.py"), str(tmp_path_factory.mktemp("faults")), *FAULTS]
    with inside(command, {"PYTHONPATH": path}) as process:
        lines = process.stdout.read().splitlines()
    assert process.returncode == 0
    found = {}
    for line in lines:
        fault, _, listed = line.partition("\t")
        found[fault] = [(f["subject"], f["code"], f["what"], f["remedy"]) for f in json.loads(listed)["findings"]]
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "subject", "code", "words"),
    [
        ("loss", AWAY, "network.loss", "got lost on the way"),
        ("MTU", AWAY_ADDRESS, "mtu.too_large", "9000 bytes"),
        ("no multicast", AWAY_ADDRESS, "multicast.blocked", "does not arrive here"),
        ("firewall", AWAY_ADDRESS, "firewall.drops", "UDP 8150 to 8399"),
    ],
)
def test_the_doctor_names_each_fault_of_the_network_with_a_remedy(said, fault, subject, code, words):
    mine = [finding for finding in said[fault] if finding[:2] == (subject, code)]
    assert mine, [finding for finding in said[fault] if not finding[1].endswith(".ok")]
    assert words in mine[0][2] and mine[0][3]
    assert code not in {finding[1] for finding in said["none"] if finding[0] == subject}


@pytest.mark.slow
def test_hosts_without_a_fault_hear_each_other(said):
    found = {(AWAY_ADDRESS, "mtu.ok"), (AWAY_ADDRESS, "discovery.ok"), (AWAY, "silhouettes.ok"), (AWAY, "clock.ok")}
    assert found <= {finding[:2] for finding in said["none"]}
