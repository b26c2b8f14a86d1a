"""Keystores of the graph that runs: who may do what, and signatures that another program (openssl) verifies."""

import queue
import shutil
import subprocess
import xml.etree.ElementTree as ET

import pytest
from test_supervisor_graph import camera, tiny

from sagoma_tools.cli import main
from sagoma_tools.commands.security import enclave_of
from sagoma_tools.graph.process_group import ProcessSettings, enclave_arguments
from sagoma_tools.graph.supervisor import Supervisor

OPENSSL = shutil.which("openssl")
needs_openssl = pytest.mark.skipif(OPENSSL is None, reason="openssl is not installed")


def openssl(*arguments):
    return subprocess.run([OPENSSL, *map(str, arguments)], capture_output=True, text=True)


@pytest.fixture(scope="module")
def keystore(tmp_path_factory):
    """The keystore of a graph of two tiny nodes that runs, made by the command."""
    folder = tmp_path_factory.mktemp("security")
    with Supervisor([tiny("hull_server"), camera("cam01")], folder / "run") as run:
        run.configure()
        assert main(["security", str(folder / "keys"), "--expect", "2", "--wait", "60"]) == 0
    return folder / "keys"


def rules(keystore, enclave):
    """DDS topics that an enclave may write and read."""
    grant = ET.parse(keystore / "enclaves" / "sagoma" / enclave / "permissions.xml").getroot().find("permissions/grant")
    assert grant.find("subject_name").text == f"CN=/sagoma/{enclave}" and grant.find("default").text == "DENY"
    found = (grant.findall(f"allow_rule/{verb}/topics/topic") for verb in ("publish", "subscribe"))
    return tuple({topic.text for topic in topics} for topics in found)


def test_enclaves_allow_what_the_nodes_do_in_the_running_graph_and_nothing_else(keystore):
    writes, reads = rules(keystore, "cam01")
    assert {"rt/diagnostics", "ros_discovery_info", "rr/cam01/camera_client/change_stateReply"} <= writes
    assert {"rq/cam01/camera_client/change_stateRequest", "rt/parameter_events"} <= reads
    assert not any("hull_server" in topic for topic in writes | reads) and "*" not in writes | reads
    assert any("hull_server" in topic for topic in rules(keystore, "mocap_server")[0])
    assert rules(keystore, "tools") == ({"*"}, {"*"})


@needs_openssl
def test_signatures_and_certificates_verify_and_changed_documents_do_not(keystore, tmp_path):
    authority, enclave = keystore / "public" / "ca.cert.pem", keystore / "enclaves" / "sagoma" / "cam01"
    assert openssl("verify", "-CAfile", authority, enclave / "cert.pem").returncode == 0
    verify = ("smime", "-verify", "-CAfile", authority, "-in")
    for file in ("permissions.p7s", "governance.p7s"):
        done = openssl(*verify, enclave / file)
        assert done.returncode == 0, done.stderr
    assert "<allow_unauthenticated_participants>false" in done.stdout
    forged = tmp_path / "forged.p7s"
    forged.write_text((enclave / "permissions.p7s").read_text().replace("DENY", "ALLOW"))
    assert openssl(*verify, forged).returncode != 0
    own = openssl("pkey", "-in", enclave / "key.pem", "-pubout").stdout
    assert own and own == openssl("x509", "-in", enclave / "cert.pem", "-pubkey", "-noout").stdout


def test_private_keys_are_for_their_owner_alone(keystore):
    keys = [*keystore.rglob("*key.pem")]
    assert len(keys) == 4 and all(key.stat().st_mode & 0o077 == 0 for key in keys)


def test_processes_get_their_enclave_when_security_is_switched_on(monkeypatch, tmp_path):
    run = Supervisor([tiny("hull_server"), camera("cam01")], tmp_path)
    monkeypatch.delenv("ROS_SECURITY_ENABLE", raising=False)
    assert [enclave_arguments(process) for process in run.processes.specs] == [[], []]
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    given = [enclave_arguments(process)[1] for process in run.processes.specs]
    assert given == ["/sagoma/mocap_server", "/sagoma/cam01"]
    assert [enclave_of(name) for name in ("/icp_tracker", "/cam01/camera_client")] == ["mocap_server", "cam01"]


def test_node_that_cannot_be_secured_refuses_to_run_open(keystore, monkeypatch, tmp_path):
    """Of the wheels' Fast DDS, which has no security compiled in: an open graph would be the worse answer."""
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(keystore))
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    told = queue.Queue()
    secured = {"ROS_SECURITY_ENABLE": "true"}
    run = Supervisor([tiny("hull_server")], tmp_path / "run", ProcessSettings(env=secured), on_event=told.put)
    run.start()
    try:
        death = told.get(timeout=60.0)
        assert "exit status 1" in death.reason
        assert "doesn't have the security libraries" in death.log_tail or "enclave" in death.log_tail
    finally:
        run.stop()
